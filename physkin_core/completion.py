"""Completion of the `physkin` command in shells, by shtab (extra `[completion]`)."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

from physkin_core.model.model_file import shipped_models
from physkin_core.motion.loading import bundled_motions

__all__ = ["SHELLS", "completion_script"]

SHELLS = ("bash", "zsh", "fish")
FILES = ("AVATAR", "BAG", "FILE", "FOLDER", "PATH", "PNG")
"""What metavars of files are called."""
NAMES: dict[str, Callable] = {"MODEL": shipped_models, "MOTION": bundled_motions}
"""Metavar -> what ships under a name, beside files."""


def completion_script(parser: argparse.ArgumentParser, shell: str) -> str:
    """What the shell reads to complete the parser's commands, options and files. shell: one of `SHELLS`.

    Raises ModuleNotFoundError without shtab."""
    import shtab

    names = {metavar: find() for metavar, find in NAMES.items()}
    preamble = {"bash": "".join(map(_bash_function, names.items()))}
    for action in _all_actions(parser):
        if action.metavar in names and shell == "bash":
            action.complete = {"bash": f"_physkin_{action.metavar.lower()}"}
        elif action.type is Path or action.metavar in (*FILES, *names):
            action.complete = shtab.FILE
    return shtab.complete(parser, shell, preamble=preamble)


def _bash_function(named: tuple[str, tuple[str, ...]]) -> str:
    """Offers names and files."""
    metavar, names = named
    return f'_physkin_{metavar.lower()}() {{ compgen -W "{" ".join(names)}" -- "$1"; compgen -f -- "$1"; }}\n'


def _all_actions(parser: argparse.ArgumentParser) -> list[argparse.Action]:
    """Options and arguments of a parser and of its commands."""
    found = []
    for action in parser._actions:  # argparse has no public way to them
        found.append(action)
        if isinstance(action.choices, dict):
            for command in action.choices.values():
                found += _all_actions(command)
    return found
