"""What the site needs beside Markdown: equations as MathML, which browsers draw by themselves; titles of files."""

from __future__ import annotations

import re
from typing import Any

from latex2mathml.converter import convert

#: Code, which is left as it is, or an equation: $$ on lines of its own, or $ within a line.
_PARTS = re.compile(
    r"(^```.*?^```|`[^`\n]*`)|\$\$(.+?)\$\$|(?<![\w$\\])\$(?=\S)([^$\n]+?)(?<=\S)\$(?![\w$])", re.S | re.M
)
#: The first line of a block that is a file: its language and name.
_FILE = re.compile(r"^( *```\w+) ([\w.]+)$", re.MULTILINE)


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Return the page with its equations as MathML."""

    def replaced(found: re.Match[str]) -> str:
        code, block, within = found.groups()
        if code:
            return str(code)
        return str(convert((block or within).strip(), display="block" if block else "inline"))

    return _PARTS.sub(replaced, _FILE.sub(r'\1 title="\2"', markdown))
