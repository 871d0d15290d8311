"""Child processes that never outlive their parent's `with` block, nor leave shared memory behind."""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path

from physkin_ros.middleware.shared_memory import remove_shared_memory, shared_memory_of

__all__ = ["ChildFailedError", "Children"]

STOP_SECONDS = 5.0
LIBC = ctypes.CDLL(None) if sys.platform == "linux" else None
PR_SET_PDEATHSIG = 1


class ChildFailedError(RuntimeError):
    """A child process ended with an error, or did not do in time what it was waited for."""


class Children:
    """Runs Python modules as child processes, each with its own log; ends all of them on leaving the `with` block.

    environment: of every child. logs: folder for their output.
    """

    def __init__(self, environment: Mapping[str, str], logs: Path) -> None:
        self._environment = dict(environment)
        if not {"", os.getcwd()} & set(sys.path):  # `python -m` must not look for packages where the parent did not
            self._environment["PYTHONSAFEPATH"] = "1"
        self._logs = logs
        self._processes: dict[str, subprocess.Popen] = {}

    def __enter__(self) -> Children:
        return self

    def __exit__(self, *exception) -> None:
        self.stop()

    def start(self, name: str, module: str, *arguments: object) -> None:
        """Start `python -m module argument...`."""
        command = [sys.executable, "-m", module, *map(str, arguments)]
        with open(self._logs / name, "w") as log:
            self._processes[name] = subprocess.Popen(
                command,
                env=self._environment,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                start_new_session=True,  # a terminal's Ctrl-C reaches the parent alone, which ends them in order
                preexec_fn=_end_with_parent,
            )

    def pid(self, name: str) -> int:
        """Process id of a child."""
        return self._processes[name].pid

    def log(self, name: str) -> str:
        """What a child has written so far."""
        return (self._logs / name).read_text(errors="replace")

    def finished(self, name: str) -> bool:
        """Whether a child has ended."""
        return self._processes[name].poll() is not None

    def wait(self, done: Callable[[], bool], what: str, seconds: float) -> None:
        """Wait until `done()`. Raises ChildFailedError when a child fails meanwhile, or after `seconds`."""
        deadline = time.monotonic() + seconds
        while not done():
            self._check()
            if time.monotonic() > deadline:
                logs = "\n".join(f"{name}:\n{self.log(name)}" for name in self._processes)
                raise ChildFailedError(f"{what}: not within {seconds:.0f} s\n{logs}")
            time.sleep(0.05)
        self._check()

    def stop(self) -> None:
        """End every child: SIGINT, and SIGKILL for one that does not heed it."""
        opened: set[str] = set()
        running = [process for process in self._processes.values() if process.poll() is None]
        for process in running:
            opened |= shared_memory_of(process.pid)
            process.send_signal(signal.SIGINT)
        deadline = time.monotonic() + STOP_SECONDS
        for process in running:
            try:
                process.wait(max(0.0, deadline - time.monotonic()))
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        if any(process.returncode < 0 for process in self._processes.values()):
            remove_shared_memory(opened)

    def _check(self) -> None:
        for name, process in self._processes.items():
            if process.poll():
                raise ChildFailedError(f"the {name} ended with status {process.returncode}:\n{self.log(name)}")


def _end_with_parent() -> None:
    """In the child: have the kernel end it should the parent be killed before it can do so."""
    if LIBC is not None:
        LIBC.prctl(PR_SET_PDEATHSIG, signal.SIGTERM)
