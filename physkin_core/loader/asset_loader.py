"""AssetLoader: outfits, avatars and motion out of files that this process never opens."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from weakref import WeakValueDictionary

from physkin_core.loader.memory import return_memory
from physkin_core.loader.requests import AvatarRequest, LoadedAvatar, LoadedOutfit, MotionRequest, OutfitRequest
from physkin_core.motion.motion import Motion
from physkin_core.outfit.outfit import Outfit
from physkin_core.runtime.evaluator import Precision
from physkin_core.worker.process import Worker

__all__ = ["LOAD_MEMORY_LIMIT", "LOAD_TIMEOUT", "AssetLoader"]

LOAD_TIMEOUT, LOAD_MEMORY_LIMIT = 180.0, 4096
"""[s] and [MiB] that one request may take."""


class AssetLoader:
    """Has files read, checked, fitted and bound by a process of its own, one at a time, from any thread.

    What such a process cannot survive, such as a file that is truncated while it is read, costs the request; the next
    one is answered by another process. seconds, memory [MiB]: that one request may take.
    All requests raise ValueError, in one sentence: what is wrong with a file, what cannot be worn so, or that the
    process was ended, has needed too much, was cancelled, or is closed.
    """

    def __init__(self, *, seconds: float = LOAD_TIMEOUT, memory: int = LOAD_MEMORY_LIMIT) -> None:
        self._worker = Worker("physkin_core.loader.loading_process", seconds=seconds, memory=memory)
        self._worn: WeakValueDictionary[tuple[str, Precision | None], Outfit] = WeakValueDictionary()

    @property
    def pid(self) -> int:
        """Of the process that loads."""
        return self._worker.pid

    def outfit(self, request: OutfitRequest, *, precision: Precision | None = None) -> tuple[Outfit, LoadedOutfit]:
        """An outfit, and what else was asked for. One that is worn already, by whomever, shares its arrays."""
        worn = dict(self._worn)
        known = tuple(key for key, other in worn if other == precision)
        what = f"{', '.join(garment.model for garment in request.garments)} on {request.body}"
        loaded: LoadedOutfit = self._worker.ask(replace(request, known=known), what)
        key = loaded.key, precision
        if loaded.bound is not None:
            outfit = Outfit.from_bound(loaded.bound, precision=precision)
        else:
            outfit = worn[key].twin()
            outfit.avatar = replace(outfit.avatar, source=request.body)  # the same body may have another name
        self._worn[key] = outfit
        return_memory()
        return outfit, loaded

    def avatar(
        self, body: str | Path, *, rig_file: str | Path | None = None, bones: str | Path | None = None
    ) -> LoadedAvatar:
        """A body bound to the body model's rig."""
        return self._worker.ask(AvatarRequest(str(body), str(rig_file or ""), str(bones or "")), str(body))

    def motion(self, motion: str | Path, **settings: str | float | None) -> Motion:
        """A motion, as `load_motion` reads it with these settings."""
        return self._worker.ask(MotionRequest(str(motion), **settings), str(motion))

    def cancel(self) -> None:
        """Let a request that is being answered fail at once."""
        self._worker.cancel()

    def close(self) -> None:
        """End the process."""
        self._worker.close()
