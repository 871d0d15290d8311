"""Garments are put on again when their files are written anew, as `physkin fit-garment` does while it trains."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from threading import Event, Thread

from physkin_core.model.model_file import split_fabric
from physkin_core.view.scene.scene_state import SceneState

__all__ = ["follow_files"]

LOOK_EVERY = 1.0
"""[s] from one look at the files to the next."""


def follow_files(state: SceneState, on_change: Callable[[Exception | None], None]) -> Callable[[], None]:
    """Look after the files of the garments that a state shows, in a thread of its own. Returns a function that ends it.

    on_change: called once garments were put on again, with None, or with the error that kept them from it."""
    ended, seen = Event(), _written(state)

    def follow() -> None:
        nonlocal seen
        while not ended.wait(LOOK_EVERY):
            try:
                before, seen = seen, _written(state)
                if any(before.get(file, at) != at for file, at in seen.items()):
                    state.wear(state.garments, tucked=state.tucked)
                    on_change(None)
            except (ValueError, OSError) as error:
                on_change(error)

    Thread(target=follow, daemon=True).start()
    return ended.set


def _written(state: SceneState) -> dict[Path, int]:
    """When each file was written [ns]; a shipped name is none, nor is one that is gone."""
    files = [Path(split_fabric(name)[0]) for name in state.garments]
    return {file: file.stat().st_mtime_ns for file in files if file.is_file()}
