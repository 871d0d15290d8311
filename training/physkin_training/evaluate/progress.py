"""How far an evaluation has come, as bars on a terminal."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

__all__ = ["MINIMA", "Watch", "progress"]

Watch = Callable[[str, int], None]
"""Told what is being measured, and how many more pairs of it are done."""
MINIMA = "minima"
"""What `Watch` is told of pairs that are minimised, which take much longer."""


@contextmanager
def progress(*, measured: int, minimised: int) -> Iterator[Watch]:
    """A bar each for so many pairs measured and minimised, on standard error if that is a terminal, with what is being
    measured and the time left. They go when the block ends."""
    columns = (
        *(TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TextColumn("pairs,")),
        *(TimeRemainingColumn(), TextColumn("left")),
    )
    disabled = not sys.stderr.isatty()
    with Progress(*columns, console=Console(stderr=True), transient=True, disable=disabled) as bars:
        clips = bars.add_task("", total=measured)
        minima = bars.add_task(MINIMA, total=minimised, visible=minimised > 0)

        def watch(what: str, pairs: int) -> None:
            if what == MINIMA:
                bars.advance(minima, pairs)
            else:
                bars.update(clips, advance=pairs, description=what)

        yield watch
