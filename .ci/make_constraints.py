"""Merge pip's resolution reports of several Python versions into one constraints file.

Usage, with one report per supported Python made by
`pip install --dry-run --ignore-installed --report report_3.11.json '.[ros,test]'`:

    python .ci/make_constraints.py 3.10=report_3.10.json 3.11=report_3.11.json 3.12=report_3.12.json > constraints.txt
"""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path


def main(arguments: list[str]) -> None:
    versions: dict[str, dict[str, str]] = {}
    pythons = []
    for argument in arguments:
        python, path = argument.split("=", 1)
        pythons.append(python)
        for item in json.loads(Path(path).read_text())["install"]:
            name = re.sub(r"[-_.]+", "-", item["metadata"]["name"]).lower()
            if name != "humanpred-ros":
                versions.setdefault(name, {})[python] = item["metadata"]["version"]
    print("# Versions the tests ran with, for Python " + ", ".join(pythons) + ". Made by .ci/make_constraints.py.")
    for name in sorted(versions):
        by_python = versions[name]
        if len(by_python) == len(pythons) and len(set(by_python.values())) == 1:
            print(f"{name}=={by_python[pythons[0]]}")
            continue
        for python, version in by_python.items():
            print(f'{name}=={version} ; python_version == "{python}"')


if __name__ == "__main__":
    main(sys.argv[1:])
