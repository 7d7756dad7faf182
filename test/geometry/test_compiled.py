"""Compiled functions are kept outside the package, and are compiled anew when anything they are made of changes."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from paths import REPOSITORY

from humanpred_ros.geometry import compiled
from humanpred_ros.geometry.compiled import (
    MARK,
    MARKS,
    _compiling_imports,
    announced,
    exact,
    exact_part,
    remove_unused,
    source_digest,
)

PACKAGE = REPOSITORY / "humanpred_ros"
COMPILING = [source for source in sorted(PACKAGE.rglob("*.py")) if MARK in source.read_text(encoding="utf-8")]
DECORATORS = {"exact", "fast", "exact_part", "fast_part", "fast_inline"}

KERNELS = f"{MARK} exact\n@exact\ndef twice(x):\n    return {{factor}} * x\n"
USERS = f"{MARK} exact\nfrom humanpred_ros.kernels import twice\n@exact\ndef again(x):\n    return twice(twice(x))\n"


def names_compiled(tree: ast.Module) -> set[str]:
    """Return the names of the module that its compiled functions come to, by way of its constants, too."""
    values = {
        target.id: node.value
        for node in tree.body
        if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None
        for target in (node.targets if isinstance(node, ast.Assign) else [node.target])
        if isinstance(target, ast.Name)
    }
    functions = {node.name: node for node in tree.body if isinstance(node, ast.FunctionDef)}
    compiled = {
        name
        for name, node in functions.items()
        if DECORATORS & {decorator.id for decorator in node.decorator_list if isinstance(decorator, ast.Name)}
    }
    found: set[str] = set()
    waiting = set(compiled)
    while waiting:
        name = waiting.pop()
        found.add(name)
        parts: list[ast.AST] = list(functions[name].body) if name in functions else []
        parts += [values[name]] if name in values else []
        waiting |= {node.id for part in parts for node in ast.walk(part) if isinstance(node, ast.Name)} - found
    return found


def sources_of(tree: ast.Module) -> Iterator[tuple[str, Path]]:
    """Yield what a module imports from others of the package, and their files."""
    for node in tree.body:
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("humanpred_ros"):
            file = REPOSITORY / str(node.module).replace(".", "/")
            for alias in node.names:
                inside = file / f"{alias.name}.py"
                yield alias.asname or alias.name, inside if inside.exists() else file.with_suffix(".py")


@pytest.mark.parametrize("source", COMPILING, ids=lambda source: str(source.relative_to(PACKAGE)))
def test_what_is_compiled_uses_only_what_the_digest_covers(source: Path) -> None:
    tree = ast.parse(source.read_text(encoding="utf-8"))
    used = names_compiled(tree)
    assert used, "nothing is compiled here"
    outside = {
        name: file
        for name, file in sources_of(tree)
        if name in used and not any(mark in file.read_text(encoding="utf-8") for mark in MARKS)
    }
    assert outside == {}


def test_numba_is_used_by_way_of_compiled_only() -> None:
    users = {
        source.relative_to(PACKAGE).as_posix()
        for source in PACKAGE.rglob("*.py")
        for node in ast.walk(ast.parse(source.read_text(encoding="utf-8")))
        if (isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "numba")
        or (isinstance(node, ast.Import) and any(alias.name.split(".")[0] == "numba" for alias in node.names))
    }
    assert users == {"geometry/compiled.py"}


def a_package(folder: Path) -> Path:
    """Write a package of the same name whose one kernel uses another file's."""
    package = folder / "humanpred_ros"
    (package / "geometry").mkdir(parents=True)
    for name in ("__init__", "geometry/__init__", "geometry/compiled", "resources", "errors"):
        (package / f"{name}.py").write_bytes((PACKAGE / f"{name}.py").read_bytes())
    (package / "kernels.py").write_text(KERNELS.format(factor=2), encoding="utf-8")
    (package / "users.py").write_text(USERS, encoding="utf-8")
    return package


def run(package: Path, cache: dict[str, str]) -> list[str]:
    """Return what the package's kernel makes of 1, in a process of its own, and from where it was loaded, if it was."""
    program = (
        "from humanpred_ros.users import again as f\nprint(f(1), sum(f.stats.cache_hits.values()), f.stats.cache_path)"
    )
    environment = {**os.environ, "PYTHONPATH": str(package.parent), "PYTHONDONTWRITEBYTECODE": "1"}
    for name in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME"):
        environment.pop(name, None)
    done = subprocess.run(
        [sys.executable, "-c", program], env={**environment, **cache}, cwd=package.parent,
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    return done.stdout.split()


def test_compiled_functions_are_kept_until_something_they_use_changes(tmp_path: Path) -> None:
    package, cache = a_package(tmp_path), {"XDG_CACHE_HOME": str(tmp_path / "cache")}
    result, hits, where = run(package, cache)
    assert (result, hits) == ("4", "0")
    assert Path(where).is_relative_to(tmp_path / "cache" / "humanpred_ros")
    assert run(package, cache) == ["4", "1", where]
    # Numba alone would go on with the old one: the file `users` has not changed.
    (package / "kernels.py").write_text(KERNELS.format(factor=3), encoding="utf-8")
    result, hits, elsewhere = run(package, cache)
    assert (result, hits) == ("9", "0")
    assert elsewhere != where
    assert not list(package.rglob("*.nb?"))


def test_numba_s_own_setting_is_honoured(tmp_path: Path) -> None:
    package = a_package(tmp_path)
    _, _, where = run(package, {"NUMBA_CACHE_DIR": str(tmp_path / "mine"), "XDG_CACHE_HOME": str(tmp_path / "cache")})
    assert Path(where).is_relative_to(tmp_path / "mine" / "humanpred_ros")


@pytest.mark.parametrize("unusable", [{"XDG_CACHE_HOME": "/dev/null"}, {"HOME": "/dev/null"}], ids=["cache", "home"])
def test_without_a_cache_folder_functions_are_kept_beside_their_sources(
    tmp_path: Path, unusable: dict[str, str]
) -> None:
    package = a_package(tmp_path)
    result, _, where = run(package, unusable)
    assert result == "4"
    assert Path(where) == package / "__pycache__"
    assert run(package, unusable) == ["4", "1", where]


def test_the_digest_covers_a_file_and_what_it_compiles_from(tmp_path: Path) -> None:
    package = a_package(tmp_path)

    def digests() -> list[str]:
        """Digests of the two files, and of a package whose imports were not read before."""
        _compiling_imports.cache_clear()
        return [source_digest(package / f"{name}.py", package) for name in ("kernels", "users")]

    before = digests()
    (package / "errors.py").write_text("", encoding="utf-8")
    assert digests() == before
    # An edit of a file changes what imports from it, and nothing else.
    (package / "users.py").write_text(USERS + "# edited\n", encoding="utf-8")
    after_users = digests()
    assert after_users[0] == before[0]
    assert after_users[1] != before[1]
    (package / "kernels.py").write_text(KERNELS.format(factor=5), encoding="utf-8")
    after_kernels = digests()
    assert after_kernels[0] != before[0]
    assert after_kernels[1] != after_users[1]
    (package / "geometry" / "compiled.py").write_text("", encoding="utf-8")
    assert digests()[0] != after_kernels[0]


@pytest.mark.parametrize(
    "line",
    [
        "from humanpred_ros.kernels import twice",
        "from humanpred_ros import kernels",
        "from humanpred_ros.kernels import (\n    thrice,\n    twice,\n)",
        "from humanpred_ros import errors, kernels as others",
    ],
)
def test_every_way_to_import_a_compiling_file_is_seen(tmp_path: Path, line: str) -> None:
    package = a_package(tmp_path)
    (package / "users.py").write_text(f"{MARK} exact\n{line}\n", encoding="utf-8")
    assert package / "kernels.py" in _compiling_imports(package / "users.py", package)


def test_compiling_is_announced_once_and_only_where_something_compiles(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(compiled, "cache_folder", lambda source: str(tmp_path))
    lines: list[str] = []

    @exact_part
    def half(x: float) -> float:
        return 0.5 * x

    @exact
    def quarter(x: float) -> float:
        return half(half(x))

    with announced("the test", lines.append):
        assert quarter(1.0) == 0.25
        assert quarter(1) == 0.25
    assert len(lines) == 2
    assert all("the test" in line for line in lines)
    assert "once" in lines[0]
    with announced("the test", lines.append):
        quarter(2.0)
    assert len(lines) == 2
    # A part has no entry for Python, which runs its source instead.
    assert half(3.0) == 1.5


def test_only_folders_nobody_used_are_removed(tmp_path: Path) -> None:
    for name, used_s in (("old", 100.0), ("new", 300.0)):
        (tmp_path / name).mkdir()
        (tmp_path / name / "kernel.nbc").write_bytes(b"")
        os.utime(tmp_path / name, (used_s, used_s))
    remove_unused(tmp_path, 200.0)
    assert [entry.name for entry in tmp_path.iterdir()] == ["new"]
