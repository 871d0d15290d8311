"""`physkin doctor`: check this installation, and say what to do where something does not work."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from typing import Literal

__all__ = ["Finding", "command_parser", "main"]

DOCTORS = {
    "physkin_core.doctor.installation": (),
    "physkin_ros.middleware.doctor": ("rclpy",),
    "physkin_training.doctor": ("torch", "warp"),
}
"""Module with a `look()` -> what has to be installed for it to be of use. A part that is not installed is reported
as a missing extra."""


@dataclass(frozen=True)
class Finding:
    """subject: what it is about. state: "good", "note" (all else works without it) or "broken" (installed or
    needed, and does not work). found: in words. remedy: what to do; empty if nothing."""

    subject: str
    state: Literal["good", "note", "broken"]
    found: str
    remedy: str = ""


def command_parser() -> argparse.ArgumentParser:
    """Options of `physkin doctor`."""
    return argparse.ArgumentParser(prog="physkin doctor", description=__doc__.split("`: ")[1])


def main(argv: list[str]) -> int:
    """Command line. Returns 0, or 1 where something is broken."""
    command_parser().parse_args(argv)
    broken = 0
    for finding in _findings():
        broken += finding.state == "broken"
        print(f"{finding.state:<6}  {finding.subject:<15} {finding.found}", flush=True)
        if finding.remedy:
            print(f"{'':24}-> {finding.remedy}", flush=True)
    print(f"\n{broken} broken" if broken else "\neverything that is installed works")
    return 1 if broken else 0


def _findings() -> Iterator[Finding]:
    for module, needed in DOCTORS.items():
        if find_spec(module.split(".")[0]) is None or any(find_spec(package) is None for package in needed):
            continue
        try:
            yield from import_module(module).look()
        except Exception as error:  # whatever a damaged installation raises: report it, and go on
            part = module.split(".")[0]
            found = f"{type(error).__name__}: {' '.join(str(error).split())}"
            yield Finding(part, "broken", found, "install what it names again; physkin --debug shows where")
