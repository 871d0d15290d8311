"""How the project is built: which way imports point, how large folders and files are. Each rule is shown to fail."""

from __future__ import annotations

import ast
from collections import Counter
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

from import_graph import PACKAGES, ROOT, SCRIPTS, import_graph, modules, room_graph

MOST_FILES, MOST_LINES = 30, 500
"""Python files a folder; lines a file, of C++ too. Far above what is usual (a dozen, 200): they find what has outgrown
its idea, and are not there to be filled."""

MAY_IMPORT = {
    "physkin_core": set(),
    "physkin_ros": {"physkin_core"},
    "physkin_training": {"physkin_core"},
    "physkin_bench": {"physkin_core"},
    "physkin_prepare": {"physkin_core", "physkin_training"},
}
"""Package -> others of ours that it may import."""

NEVER = {"physkin_core": {"torch", "warp", "rclpy"}, "physkin_training": {"rclpy"}}
"""Package -> what it never imports, not even inside a function."""


def circle(graph):
    """The first circle of a graph, or nothing."""
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return error.args[1]
    return []


def wrong_directions(found):
    """Imports of a package that it may not have, and relative ones."""
    wrong = []
    for name, module in found.items():
        package = name.split(".")[0]
        barred = (PACKAGES.keys() - MAY_IMPORT[package] - {package}) | NEVER.get(package, set()) | {""}
        wrong += [f"{name} -> {target}" for target in module.imports if target.split(".")[0] in barred]
    return sorted(wrong)


def python_files(root):
    """Of the packages and the tests."""
    for folder in (*PACKAGES.values(), "tests", "docs"):
        yield from (path for path in (root / folder).rglob("*.py") if path.is_file())


def too_large(root):
    """Folders of too many files, files of too many lines."""
    files = list(python_files(root))
    folders = Counter(path.parent for path in files)
    wrong = [f"{folder.relative_to(root)}: {count} files" for folder, count in folders.items() if count > MOST_FILES]
    lines = {path: len(path.read_text().splitlines()) for path in (*files, *(root / "native").rglob("*.?pp"))}
    return wrong + [f"{path.relative_to(root)}: {count} lines" for path, count in lines.items() if count > MOST_LINES]


def without_docstring(root):
    """Folders of a package with Python files but no `__init__` that says what the folder is."""
    wrong = []
    for package in PACKAGES.values():
        for folder in sorted({path.parent for path in (root / package).rglob("*.py")}):
            init = folder / "__init__.py"
            said = init.is_file() and ast.get_docstring(ast.parse(init.read_text()))
            if not said and folder.relative_to(root / package).parts[:1] not in [(name,) for name in SCRIPTS]:
                wrong.append(str(folder.relative_to(root)))
    return wrong


@pytest.fixture(scope="module")
def found():
    """The modules of this repository."""
    return modules()


def test_no_circle_between_files(found):
    assert circle(import_graph(found)) == []


def test_no_circle_between_rooms(found):
    """Folders of a package; a file directly in its package is a room of its own."""
    assert circle(room_graph(found)) == []


def test_directions(found):
    """physkin_ros -> physkin_core <- physkin_training; absolute imports; nothing heavy in the run time."""
    assert wrong_directions(found) == []


def test_folders_and_files_are_small():
    assert too_large(ROOT) == []


def test_every_folder_says_what_it_is():
    assert without_docstring(ROOT) == []


# --- Each rule, on a made-up tree that breaks it ---


@pytest.fixture
def tree(tmp_path):
    """Writes files of a made-up repository: path -> text. Every package is there, with docstrings."""

    def write(**files: str) -> Path:
        for folder in PACKAGES.values():
            path = tmp_path / folder / "__init__.py"
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text('"""A package."""\n')
        for name, text in files.items():
            path = tmp_path / "physkin_core" / f"{name.replace('__', '/')}.py"
            path.parent.mkdir(exist_ok=True)
            path.write_text(text)
            (path.parent / "__init__.py").write_text('"""A folder."""\n')
        return tmp_path

    return write


def test_circle_of_files_is_found(tree):
    """An import inside a function closes it; one for type checking alone does not."""
    closed = tree(a__one="import physkin_core.a.two", a__two="def f():\n    from physkin_core.a.one import x")
    assert set(circle(import_graph(modules(closed)))) == {"physkin_core.a.one", "physkin_core.a.two"}
    types = "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from physkin_core.a import one"
    assert circle(import_graph(modules(tree(a__two=types)))) == []


def test_circle_of_rooms_is_found(tree):
    """Where no file is in a circle."""
    root = tree(
        a__one="from physkin_core.b import one", b__two="from physkin_core.a.two import x", a__two="", b__one=""
    )
    assert circle(import_graph(modules(root))) == []
    assert set(circle(room_graph(modules(root)))) == {"physkin_core.a", "physkin_core.b"}


@pytest.mark.parametrize(
    "text", ["from physkin_ros.node import settings", "def f():\n    import torch.nn", "from . import rig"]
)
def test_wrong_direction_is_found(tree, text):
    assert [line.split()[0] for line in wrong_directions(modules(tree(rig=text)))] == ["physkin_core.rig"]


def test_large_folder_and_file_are_found(tree):
    root = tree(**{f"a__m{k}": "" for k in range(MOST_FILES)}, b__long="\n" * (MOST_LINES + 1))
    (root / "native").mkdir()
    (root / "native" / "long.cpp").write_text("\n" * (MOST_LINES + 1))
    found = ["physkin_core/a: 31 files", "physkin_core/b/long.py: 501 lines", "native/long.cpp: 501 lines"]
    assert too_large(root) == found


def test_missing_docstring_is_found(tree):
    root = tree(a__one="", b__one="")
    (root / "physkin_core/a/__init__.py").write_text("import os\n")
    (root / "physkin_core/b/__init__.py").unlink()
    assert without_docstring(root) == ["physkin_core/a", "physkin_core/b"]
