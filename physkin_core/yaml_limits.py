"""Limits for YAML from outside, in which a few lines of nested aliases may stand for gigabytes."""

from __future__ import annotations

from collections.abc import Iterable

from physkin_core.file_reading import ContentError

__all__ = ["check_yaml"]

DEEPEST = 20


def check_yaml(events: Iterable[object]) -> None:
    """Raises ContentError for aliases and deep nesting. events: of a document, as the parsers of PyYAML and of
    ruamel.yaml give them."""
    depth = 0
    for event in events:
        kind = type(event).__name__
        depth += kind.endswith("StartEvent") - kind.endswith("EndEvent")
        if kind == "AliasEvent":
            raise ContentError("it has an alias (*NAME), which is not allowed; write the value out")
        if depth > DEEPEST:
            raise ContentError(f"it is nested more than {DEEPEST} deep")
