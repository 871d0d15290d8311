"""Building an evaluator or encoding a body takes milliseconds in which other Python threads go on."""

import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import pytest
from native_frames import NativeFrame
from random_models import random_hyper_modulator, unit_rows

from physkin_core.runtime.evaluator import Skinner


@contextmanager
def other_thread() -> Iterator[Callable[[], int]]:
    """A thread that counts; it gets its turn only where the interpreter's lock is given away."""
    count, stop, before = 0, threading.Event(), sys.getswitchinterval()

    def run():
        nonlocal count
        while not stop.is_set():
            count += 1
            time.sleep(0)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    sys.setswitchinterval(1000)
    try:
        time.sleep(0.05)  # what the thread waits for from now on is the lock, not its turn
        yield lambda: count
    finally:
        sys.setswitchinterval(before)
        stop.set()
        thread.join()


def evaluator(make_garment):
    garment = make_garment(np.random.default_rng(0), vertices=20000, pose_widths=(256,) * 4, nodes=64)
    return lambda: NativeFrame([garment])


def skinner(make_garment):
    garment = make_garment(np.random.default_rng(0), vertices=20000, nodes=64)
    return lambda: Skinner(garment)


def encoder(make_garment):
    from physkin_core.runtime.body_encoder import encode_points

    rng = np.random.default_rng(0)
    network = random_hyper_modulator(rng, 64, width=32)
    points, normals = rng.uniform(-1, 1, size=(1000, 3)), unit_rows(rng, 1000)
    return lambda: encode_points(network, points, normals)


@pytest.mark.parametrize("work", [evaluator, skinner, encoder])
def test_other_threads_go_on(work, make_garment):
    """The first of some tries in which the other thread got its turn ends the test."""
    build = work(make_garment)
    with other_thread() as count:
        for _ in range(100):
            before = count()
            build()
            if count() != before:
                return
    pytest.fail("no other thread got a turn")
