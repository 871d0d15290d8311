"""Serving callbacks for a while, in processes that wait for something."""

from __future__ import annotations

import time
from collections.abc import Callable

import rclpy
from rclpy.executors import Executor

__all__ = ["spin_until"]


def spin_until(executor: Executor, seconds: float, done: Callable[[], object]) -> bool:
    """Serve callbacks until `done()` or for `seconds`; whether it is done."""
    deadline = time.monotonic() + seconds
    while rclpy.ok() and not done() and time.monotonic() < deadline:
        executor.spin_once(timeout_sec=0.1)
    return bool(done())
