"""A process that may die: whoever asks gets one sentence, and the next request another process."""

from __future__ import annotations

import logging
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from threading import Thread

import numpy as np
import pytest

from physkin_core.worker.process import Worker, WorkerError


@pytest.fixture(scope="module")
def worker():
    """One that may take two seconds and 200 MiB."""
    worker = Worker("troublesome_worker", seconds=2.0, memory=200)
    yield worker
    worker.close()


def alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def ended(pid: int) -> bool:
    """Whether a process ends within some seconds."""
    for _ in range(100):
        if not alive(pid):
            return True
        time.sleep(0.05)
    return False


def answers(worker) -> bool:
    return worker.ask(("process", None), "it") == worker.pid


def test_answers_come_with_what_was_logged(worker, caplog):
    """From one process, another one than this. What is there twice is one object again, and may be written to."""
    values = {"records": np.ones(3, dtype=[("x", "<f4"), ("y", "<f8"), ("z", "u1")])[["x", "z"]]}
    values |= {"turned": np.arange(12.0).reshape(3, 4).T, "none": np.empty((0, 3)), "many": np.arange(300_000)}
    with caplog.at_level(logging.INFO, "physkin_core"):
        answer, more = worker.ask(("twice", values), "it")
    assert (
        answer is more["again"] and ("physkin_core.troublesome_worker", logging.INFO, "twice") in caplog.record_tuples
    )
    for name, value in values.items():
        np.testing.assert_array_equal(answer[name], value)
        assert answer[name].dtype == value.dtype and answer[name].flags.writeable
    assert answers(worker) and worker.pid != os.getpid()


def test_arrays_take_memory_once():
    """Shared memory is given back when an answer was taken, and counts among what the process may take."""
    worker = Worker("troublesome_worker", seconds=20.0, memory=200)
    try:
        assert worker.ask(("zeros", 80), "it").nbytes == 80 << 20
        assert os.fstat(worker._arrays).st_blocks == 0
        with pytest.raises(WorkerError, match="takes more than 200 MiB"):
            worker.ask(("zeros", 150), "it")
        assert answers(worker)
    finally:
        worker.close()


@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="threads are counted in /proc")
def test_one_core_is_left_to_others(worker):
    """One thread computes; the other one waits for whoever asks to go."""
    assert worker.ask(("threads", None), "it") == 2


@pytest.mark.parametrize(
    ("name", "argument", "told"),
    [
        ("end", int(signal.SIGKILL), r"body.glb could not be loaded: the process that read it was ended \(SIGKILL\)"),
        ("end", int(signal.SIGSEGV), "SIGSEGV"),
        ("leave", 3, "exit status 3"),
        ("sleep", 30, r"body.glb could not be loaded within 2 s \(load_timeout\)"),
    ],
)
def test_what_ends_the_process_costs_one_request(worker, name, argument, told):
    before = worker.pid
    with pytest.raises(WorkerError, match=told) as caught:
        worker.ask((name, argument), "body.glb")
    assert len(str(caught.value)) <= 300
    assert answers(worker) and worker.pid != before and not alive(before)


def test_a_file_that_is_truncated_while_it_is_read(worker, tmp_path):
    path = tmp_path / "body.glb"
    path.write_bytes(b"x" * 100_000)
    with pytest.raises(WorkerError, match=r"SIGBUS\); a file must not be damaged, nor be written while it is read"):
        worker.ask(("truncated", str(path)), "body.glb")
    assert answers(worker)


@pytest.mark.parametrize(
    ("name", "argument", "error", "told"),
    [
        ("fill", 400, WorkerError, r"takes more than 200 MiB of memory \(load_memory_limit\); use a smaller file"),
        ("refuse", "too wide", WorkerError, "^too wide$"),
        ("refuse", "wide " * 100, WorkerError, "…"),
        ("fail", None, RuntimeError, "KeyError: 'nothing'"),
        ("unspeakable", None, RuntimeError, "lambda"),
    ],
)
def test_what_is_refused_does_not_end_the_process(worker, name, argument, error, told):
    before = worker.pid
    with pytest.raises(error, match=told) as caught:
        worker.ask((name, argument), "body.glb")
    assert len(str(caught.value)) <= 300
    assert answers(worker) and worker.pid == before
    assert worker.ask(("fill", 100), "it") == 100 << 20


def test_it_writes_no_file(worker, tmp_path):
    with pytest.raises(WorkerError, match="too large"):
        worker.ask(("write", str(tmp_path / "file")), "it")


def test_one_that_was_killed_meanwhile_is_replaced(worker):
    before = worker.pid
    os.kill(before, signal.SIGKILL)
    os.waitid(os.P_PID, before, os.WEXITED | os.WNOWAIT)
    assert answers(worker) and worker.pid != before


def waits_for(worker, seconds) -> tuple[Thread, list[str]]:
    """A thread that has begun to wait for an answer, and the errors that it is told."""
    told = []

    def ask() -> None:
        try:
            worker.ask(("sleep", seconds), "body.glb")
        except WorkerError as error:
            told.append(str(error))

    waiting = Thread(target=ask)
    waiting.start()
    time.sleep(0.3)
    return waiting, told


def test_waiting_can_be_cancelled(worker):
    """At once; and where nobody waits, nothing is cancelled."""
    waiting, told = waits_for(worker, 1.9)
    began = time.monotonic()
    worker.cancel()
    waiting.join(5)
    assert told == ["body.glb was not loaded: loading was cancelled"] and time.monotonic() - began < 1
    assert answers(worker)
    pid = worker.pid
    worker.cancel()
    assert answers(worker) and worker.pid == pid


def test_closing_ends_process_and_waiting():
    worker = Worker("troublesome_worker", seconds=20.0, memory=200)
    assert answers(worker)
    waiting, told = waits_for(worker, 19)
    worker.close()
    waiting.join(5)
    assert len(told) == 1 and "was not loaded" in told[0] and not alive(worker.pid)
    with pytest.raises(WorkerError, match="the loader is closed"):
        worker.ask(("process", None), "it")


def test_it_ends_with_whoever_started_it(tmp_path):
    """Though that was killed, and it is busy."""
    script = (
        "import sys; sys.path.insert(0, sys.argv[1])\n"
        "from threading import Thread\n"
        "from physkin_core.worker.process import Worker\n"
        "worker = Worker('troublesome_worker', seconds=30.0, memory=200)\n"
        "worker.ask(('process', None), 'it')\n"
        "Thread(target=worker.ask, args=(('sleep', 29), 'it')).start()\n"
        "print(worker.pid, flush=True)\n"
    )
    folder = str(Path(__file__).parents[2])
    with subprocess.Popen([sys.executable, "-c", script, folder], stdout=subprocess.PIPE, text=True) as parent:
        pid = int(parent.stdout.readline())
        time.sleep(0.2)
        parent.kill()
    assert ended(pid)
