"""Which file of our packages imports which: what the architecture test holds and `draw_architecture.py` draws."""

from __future__ import annotations

import ast
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

__all__ = [
    "INSTALLED",
    "NATIVE",
    "PACKAGES",
    "ROOT",
    "SCRIPTS",
    "Module",
    "import_graph",
    "modules",
    "room",
    "room_graph",
]

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = {
    "physkin_core": "physkin_core",
    "physkin_ros": "physkin_ros",
    "physkin_training": "training/physkin_training",
    "physkin_prepare": "training/physkin_prepare",
    "physkin_bench": "training/physkin_bench",
}
"""Import package -> its folder in the repository."""
INSTALLED = ("physkin_core", "physkin_ros", "physkin_training")
"""Those of a wheel; the others are run in a clone."""

SCRIPTS = ("launch", "examples")
"""Folders of a package whose files are started or shown, never imported."""

NATIVE = "physkin_core._native"
"""What `native/src` is compiled to."""


@dataclass(frozen=True)
class Module:
    """A file of a package. imports: every dotted name it asks for, at the top or inside functions."""

    name: str
    path: Path
    imports: frozenset[str]


def modules(root: Path = ROOT, packages: Mapping[str, str] = PACKAGES) -> dict[str, Module]:
    """Name -> module, of every Python file of the packages but scripts, and of the compiled one."""
    found = {}
    for package, folder in packages.items():
        for path in sorted((root / folder).rglob("*.py")):
            parts = path.relative_to(root / folder).with_suffix("").parts
            if parts[0] in SCRIPTS:
                continue
            name = ".".join((package, *(parts[:-1] if parts[-1] == "__init__" else parts)))
            found[name] = Module(name, path, frozenset(_imports(ast.parse(path.read_text()))))
    found[NATIVE] = Module(NATIVE, root / "native/src/binding.cpp", frozenset())
    return found


def _imports(tree: ast.AST) -> Iterator[str]:
    """Dotted names; what stands under `if TYPE_CHECKING` is left out. A relative import begins with a dot."""
    if isinstance(tree, ast.If) and ast.unparse(tree.test).endswith("TYPE_CHECKING"):
        for statement in tree.orelse:
            yield from _imports(statement)
        return
    if isinstance(tree, ast.Import):
        yield from (alias.name for alias in tree.names)
    elif isinstance(tree, ast.ImportFrom):
        yield from (f"{'.' * tree.level}{tree.module or ''}.{alias.name}" for alias in tree.names)
    for child in ast.iter_child_nodes(tree):
        yield from _imports(child)


def import_graph(found: Mapping[str, Module]) -> dict[str, set[str]]:
    """Module -> modules of ours that it imports. A name of a package that is no module counts as the package."""
    graph = {}
    for name, module in found.items():
        targets = (target if target in found else target.rpartition(".")[0] for target in module.imports)
        graph[name] = {target for target in targets if target in found} - {name}
    return graph


def room(name: str, found: Mapping[str, Module]) -> str:
    """The folder a module lies in; one that lies directly in its package is a room of its own."""
    if name.count(".") == 0 or found[name].path.stem == "__init__":
        return name
    folder = name.rpartition(".")[0]
    return folder if folder.count(".") else name


def room_graph(found: Mapping[str, Module]) -> dict[str, set[str]]:
    """Room -> rooms that its modules import."""
    rooms: dict[str, set[str]] = {room(name, found): set() for name in found}
    for name, targets in import_graph(found).items():
        rooms[room(name, found)] |= {room(target, found) for target in targets}
    return {name: targets - {name} for name, targets in rooms.items()}
