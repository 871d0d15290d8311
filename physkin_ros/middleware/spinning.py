"""Executors, and serving callbacks for a while in processes that wait for something."""

from __future__ import annotations

import time
from collections.abc import Callable

import rclpy
from rclpy.context import Context
from rclpy.executors import Executor, ExternalShutdownException

__all__ = ["new_executor", "spin_until"]


def new_executor(kind: Callable[..., Executor], context: Context) -> Executor:
    """An executor of a context. Raises ExternalShutdownException where a signal has ended that: rclpy's would then be
    half made, and say so when it is collected."""
    if not context.ok():
        raise ExternalShutdownException
    return kind(context=context)


def spin_until(executor: Executor, seconds: float, done: Callable[[], object]) -> bool:
    """Serve callbacks until `done()` or for `seconds`; whether it is done."""
    deadline = time.monotonic() + seconds
    while rclpy.ok() and not done() and time.monotonic() < deadline:
        executor.spin_once(timeout_sec=0.1)
    return bool(done())
