"""Worker: the process that answers, as whoever asks sees it. It may die of a request; the next one gets another."""

from __future__ import annotations

import contextlib
import logging
import os
import signal
import subprocess
import sys
from multiprocessing.connection import Pipe
from threading import Lock
from time import monotonic
from typing import Any

from physkin_core.file_reading import sentence
from physkin_core.worker.shared_arrays import fetch, shared_file

__all__ = ["Worker", "WorkerError"]

STARTS_WITHIN = 120.0
"""[s] a process says that it is ready; that does not count as the time of its first answer."""
ENDS_WITHIN = 5.0
"""[s] a process that was killed, or has closed its end, is gone."""

ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
"""Matrix products that take every core leave none to whoever has to answer meanwhile, and are no faster: they are
small."""


class WorkerError(ValueError):
    """A request was not answered: what it asked for was refused, or was too much."""


class Worker:
    """A process that runs `module` and answers one request at a time, from any thread.

    module: calls `serve` when it is run. seconds: that an answer may take. memory: [MiB] that it may take beyond what
    the process has when it begins. The first process is begun at once, so that it is there when it is needed.

    It is begun by `subprocess`, since `multiprocessing` would import there whatever `__main__` is here, such as a node
    with all of ROS, and lets nobody set its environment; what `multiprocessing` has for talking is used.
    """

    def __init__(self, module: str, *, seconds: float, memory: int) -> None:
        self._module = module
        self.seconds, self.memory = seconds, memory
        self._asking, self._changing = Lock(), Lock()
        self._closed = self._cancelled = False
        self._begin()

    def _begin(self) -> None:
        self._ready = False
        self._arrays = shared_file()
        requests, self._requests = Pipe(duplex=False)
        self._answers, answers = Pipe(duplex=False)
        passed = requests.fileno(), answers.fileno(), self._arrays
        paths = dict.fromkeys(os.path.abspath(path) for path in sys.path)
        with requests, answers:  # which the process has, too
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", self._module, *map(str, (*passed, self.memory, self.seconds))],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                pass_fds=passed,
                env={**os.environ, **ONE_THREAD, "PYTHONPATH": os.pathsep.join(paths)},
                start_new_session=True,  # Ctrl+C is for whoever started it
            )

    @property
    def pid(self) -> int:
        """Of the process that answers now."""
        return self._process.pid

    def ask(self, request: object, what: str) -> Any:
        """The answer to a request. what: it is about, for errors. What the worker logs meanwhile is logged here.

        Raises WorkerError, in one sentence, where it was refused, took too much memory or time, ended the process, or
        was cancelled; RuntimeError for a fault in the code that answers.
        """
        with self._asking:
            if self._closed:
                raise WorkerError(f"{what} was not loaded: the loader is closed")
            if self._process.poll() is not None:  # it was killed while nobody asked
                self._replace()
            try:
                kind, said = self._answer(request)
            except (OSError, EOFError) as error:
                if not isinstance(error, TimeoutError):
                    self._wait()
                fate = self._fate(self._process.poll())
                self._replace()
                raise WorkerError(sentence(f"{what} {fate}")) from error
            finally:
                self._cancelled = False
        if kind == "answer":
            return said
        if kind == "failed":
            raise RuntimeError(said)
        if kind == "memory":
            too_much = f"it takes more than {self.memory} MiB of memory (load_memory_limit)"
            said = f"{what} could not be loaded: {too_much}; use a smaller file"
        raise WorkerError(sentence(said))

    def _answer(self, request: object) -> tuple[str, Any]:
        """What became of it, and its value. Raises EOFError or OSError, as TimeoutError, where there is none."""
        if not self._ready:
            self._receive(monotonic() + STARTS_WITHIN)
            self._ready = True
        deadline = monotonic() + self.seconds
        self._requests.send(request)
        while (said := self._receive(deadline))[0] == "log":
            name, level, text = said[1]
            logging.getLogger(name).log(level, "%s", text)
        return ("answer", fetch(*said[1], self._arrays)) if said[0] == "answer" else said

    def _receive(self, deadline: float) -> tuple[str, Any]:
        """deadline: as of `monotonic`."""
        if not self._answers.poll(max(0.0, deadline - monotonic())):
            raise TimeoutError
        return self._answers.recv()

    def _fate(self, status: int | None) -> str:
        """Why there is no answer. status: with which the process ended, None where it had not."""
        if self._cancelled:
            return "was not loaded: loading was cancelled"
        if not self._ready:
            return f"could not be loaded: the process that reads files has not started (exit status {status})"
        if status in (None, -signal.SIGALRM):
            return f"could not be loaded within {self.seconds:g} s (load_timeout); use a smaller file"
        ended = f"exit status {status}" if status >= 0 else signal.Signals(-status).name
        return (
            f"could not be loaded: the process that read it was ended ({ended}); a file must not be damaged, nor be "
            "written while it is read"
        )

    def cancel(self) -> None:
        """Let whoever waits for an answer go on without it; where nobody does, this does nothing."""
        if self._asking.locked():
            self._cancelled = True
            with self._changing:
                self._process.kill()
                self._wait()

    def close(self) -> None:
        """End the process, for good."""
        self._closed = True
        self.cancel()
        with self._asking:
            self._end()

    def _replace(self) -> None:
        with self._changing:
            self._end()
            if not self._closed:
                self._begin()

    def _end(self) -> None:
        self._process.kill()
        self._wait()
        if not self._requests.closed:
            self._requests.close()
            self._answers.close()
            os.close(self._arrays)

    def _wait(self) -> None:
        with contextlib.suppress(subprocess.TimeoutExpired):  # it hangs in a read of the system's
            self._process.wait(ENDS_WITHIN)
