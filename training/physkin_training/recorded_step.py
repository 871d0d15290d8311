"""A training step that on a GPU is recorded as a CUDA graph and replayed."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import torch

from physkin_training.quiet_warp import wp

__all__ = ["RecordedStep"]


class RecordedStep:
    """Calls `compute`; on a GPU the first call is recorded afterwards and the next ones replay the recording.

    clear: called before recording, to drop what `compute` left behind.
    """

    def __init__(self, compute: Callable[[], None], device: torch.device, *, clear: Callable[[], None]) -> None:
        self._compute, self._clear = compute, clear
        self._on_gpu = device.type == "cuda"
        self._graph: torch.cuda.CUDAGraph | None = None
        if self._on_gpu:
            wp.init()
            self._side = torch.cuda.Stream(device)
            self._warp_side = wp.stream_from_torch(self._side)

    def __call__(self) -> None:
        if not self._on_gpu:
            self._compute()
        elif self._graph is None:
            self._record()
        else:
            self._graph.replay()

    def forget(self) -> None:
        """Drop the recording: what it holds fixed has changed."""
        self._graph = None

    @contextmanager
    def beside(self) -> Iterator[None]:
        """On a GPU, torch and Warp alike on a stream of their own; it waits for the current one and is waited for."""
        if not self._on_gpu:
            yield
            return
        self._side.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(self._side), wp.ScopedStream(self._warp_side, sync_enter=False):
            yield
        torch.cuda.current_stream().wait_stream(self._side)

    def _record(self) -> None:
        """Run a real step on the side stream, then record the next ones. The recording itself changes nothing."""
        with self.beside():
            self._compute()
        torch.cuda.synchronize()
        self._clear()
        self._graph = torch.cuda.CUDAGraph()
        with (
            torch.cuda.graph(self._graph, stream=self._side),
            wp.ScopedStream(self._warp_side, sync_enter=False),
        ):
            wp.capture_begin(stream=self._warp_side, external=True)
            try:
                self._compute()
            finally:
                wp.capture_end(stream=self._warp_side)
