"""Looking at contact in a process of its own, as exact distances would hold up the frames."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from concurrent.futures import Future, ProcessPoolExecutor

from physkin_core.view.scene.figures import Contact, ContactQuestion, look_at_contact

__all__ = ["FigureProcess"]

POLITENESS = 10
"""Frames go first."""


class FigureProcess:
    """One question at a time."""

    def __init__(self) -> None:
        spawn = multiprocessing.get_context("spawn")
        self._pool = ProcessPoolExecutor(1, mp_context=spawn, initializer=_begin)
        self._asked: Future[Contact] | None = None

    @property
    def busy(self) -> bool:
        """Whether an answer has not been taken."""
        return self._asked is not None

    def ask(self, question: ContactQuestion) -> None:
        """Raises RuntimeError where it is busy."""
        if self.busy:
            raise RuntimeError("a question has not been answered yet")
        self._asked = self._pool.submit(look_at_contact, question)

    def answer(self) -> Contact | None:
        """Once, when it is there. Raises what looking has raised."""
        if self._asked is None or not self._asked.done():
            return None
        asked, self._asked = self._asked, None
        return asked.result()

    def close(self) -> None:
        """End the process."""
        self._pool.shutdown(wait=False, cancel_futures=True)


def _begin() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl+C ends the page, and that this
    os.nice(POLITENESS)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """However the page was ended."""
    multiprocessing.parent_process().join()
    os._exit(0)
