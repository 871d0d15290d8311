"""Public names that have changed since the last release: each old one is refused by a sentence that gives the new one.

The tables are emptied at the next release.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import wraps
from typing import Any, TypeVar

__all__ = ["attribute_error", "check_options", "refuse_old_names"]

Owner = TypeVar("Owner", bound=type)

OPTIONS = {
    "demo": {"--body": "--avatar"},
    "evaluate": {"--store": "--save-model"},
    "export": {"--look": "--materials"},
    "view": {"--points": "--splats"},
}
"""Subcommand -> its options."""

ATTRIBUTES = {
    "physkin_core": {"made_of": "with_fabric"},
    "BoneRotations": {"unknown": "unknown_bones"},
    "FrameInput": {
        "accelerate": "set_effective_gravity",
        "follow": "set_root_sample",
        "hang": "set_gravity",
        "move": "set_root",
        "sways": "sway",
    },
    "Garment": {"of_faces": "submesh"},
    "Layer": {"face_given": "face_visible", "given": "bound_visible", "given_garment": "visible_garment"},
    "Outfit": {"giving": "with_bound_garment"},
}
"""Of a module or class."""

ARGUMENTS = {"Outfit": {"hide": "hide_covered"}}
"""Of making an object of a class."""


def check_options(arguments: Sequence[str]) -> None:
    """Raises ValueError for an old option. arguments: of `physkin`, the subcommand first."""
    renamed = OPTIONS.get(arguments[0], {}) if arguments else {}
    for old in (argument.split("=")[0] for argument in arguments[1:]):
        if old in renamed:
            raise ValueError(f"the option {old} of physkin {arguments[0]} is now called {renamed[old]}")


def refuse_old_names(owner: Owner) -> Owner:
    """Decorator of a class of the tables: its old attributes raise AttributeError, its old arguments TypeError."""
    for old in ATTRIBUTES[owner.__name__]:
        setattr(owner, old, _Renamed(old))
    if renamed := ARGUMENTS.get(owner.__name__):
        owner.__init__ = _refusing(owner, renamed)  # type: ignore[misc]
    return owner


def _refusing(owner: type, renamed: Mapping[str, str]) -> Callable[..., None]:
    """Its constructor, refusing old arguments. renamed: old -> new."""
    construct: Callable[..., None] = owner.__init__  # type: ignore[misc]

    @wraps(construct)
    def init(self: object, *arguments: Any, **options: Any) -> None:
        for old in options.keys() & renamed.keys():
            raise TypeError(f"the argument {old} of {owner.__name__} is now called {renamed[old]}")
        construct(self, *arguments, **options)

    return init


def attribute_error(owner: str, name: str) -> AttributeError:
    """For an attribute that a module or class does not have, whether it was renamed or never there."""
    new = ATTRIBUTES[owner].get(name)
    remedy = f"is now called {new}" if new else "does not exist"
    return AttributeError(f"{owner}.{name} {remedy}")


class _Renamed:
    def __init__(self, name: str) -> None:
        self._name = name

    def __get__(self, instance: object, owner: type) -> None:
        raise attribute_error(owner.__name__, self._name)
