"""Garments are put on again when their files are written anew, as `physkin fit-garment` does while it trains."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from threading import Event, Thread

from physkin_core.model.model_file import split_fabric
from physkin_core.view.scene.scene_state import SceneState

__all__ = ["GarmentFiles"]

LOOK_EVERY = 1.0
"""[s] from one look at the files to the next."""


class GarmentFiles:
    """Looks after the files of what a state shows, in a thread of its own. on_change: called once garments were put
    on again, with None, or with the error that kept them from it."""

    def __init__(self, state: SceneState, on_change: Callable[[Exception | None], None]) -> None:
        self._state, self._on_change = state, on_change
        self._seen: dict[Path, int] = {}
        self._end = Event()
        self.look()
        self._thread = Thread(target=self._watch, daemon=True)
        self._thread.start()

    def look(self) -> bool:
        """Whether the file of a garment that is worn has changed since the last look."""
        files = [Path(split_fabric(name)[0]) for name in self._state.garments]
        now = {file: file.stat().st_mtime_ns for file in files if file.is_file()}
        changed = any(self._seen.get(file, written) != written for file, written in now.items())
        self._seen = now
        return changed

    def close(self) -> None:
        """Look no more."""
        self._end.set()

    def _watch(self) -> None:
        while not self._end.wait(LOOK_EVERY):
            try:
                if self.look():
                    self._state.wear(self._state.garments, tucked=self._state.tucked)
                    self._on_change(None)
            except (ValueError, OSError) as error:
                self._on_change(error)
