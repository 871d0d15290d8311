"""Work on a Ray cluster: rows in batches, each batch on processor cores or a GPU. Ray replaces lost workers."""

from __future__ import annotations

import argparse
import logging
import os
import socket
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

__all__ = ["Outcome", "add_address", "done_on_cluster", "tried"]

LETTING_GO = 60.0
"""Time [s] that work gets to write what it keeps when all is stopped."""
ANSWER, LOOK_EVERY = 5.0, 2.0
"""Times [s] that a cluster gets to answer, and between looks at what has ended."""
RETRIES = 3
"""New attempts for a batch whose worker was lost."""
LONGEST_BATCH = 64
"""Rows that share a binding: a second of it is little beside them."""


@dataclass(frozen=True)
class Outcome:
    """How a row ended. result: what its work returned, None if it failed. reason: why it failed, else empty."""

    row: Any
    result: Any = None
    reason: str = ""


def tried(work: Callable[[Any], Any], rows: Sequence[Any], folder: str = ".") -> list[Outcome]:
    """Do rows one after the other, paths being from a folder on. One that raises an exception has its reason, and the
    others go on."""
    os.chdir(folder)
    outcomes = []
    for row in rows:
        try:
            outcomes.append(Outcome(row, work(row)))
        except Exception as error:
            said = " ".join(str(error).split())
            known = isinstance(error, ValueError | OSError | ImportError) and said
            outcomes.append(Outcome(row, reason=said if known else f"{type(error).__name__}: {said}"))
    return outcomes


def done_on_cluster(
    work: Callable[[Any], Any],
    rows: Sequence[Any],
    *,
    address: str | None,
    cpus: int = 1,
    device: str | None = "cpu",
    alone: bool = False,
) -> Iterator[Outcome | None]:
    """Every row with how it ended, as batches end; None every `LOOK_EVERY` seconds in which none has. The cluster is
    that at an address; without one, what `RAY_ADDRESS` names or runs on this machine, else one that is started here and
    ended with the rows.

    work: is called again for rows of a batch whose worker was lost. After `RETRIES` the rows of such a batch are tried
    by themselves, so that a row that ends its process takes no other one with it. rows: those of equal `shares` are
    done one after the other. cpus: cores a batch. device: "cpu" to leave GPUs alone, None for one GPU a batch where
    there are any. alone: each row has a process of its own, so that no other one sees what it leaves behind, in memory
    or of a crash. When the caller stops listening, running work is interrupted (KeyboardInterrupt), and no more begins.
    Raises ModuleNotFoundError without Ray, ConnectionError where no cluster answers, ValueError where no machine has so
    many cores or a GPU.
    """
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # nothing is reported to anybody
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
    os.environ.setdefault("RAY_DEDUP_LOGS_SKIP_REGEX", ".")  # Ray tells of a lost worker in forty lines
    import ray

    _check_address(address)
    ray.init(address=address, log_to_driver=False, logging_level=logging.ERROR)
    running: dict[Any, Sequence[Any]] = {}
    try:
        machines = [node["Resources"] for node in ray.nodes() if node["Alive"]]
        with_gpu = [machine for machine in machines if machine.get("GPU", 0) >= 1]
        if device == "cuda" and not with_gpu:
            raise ValueError("--device cuda: no machine of the cluster has a GPU; allowed: cpu")
        gpus = int(device != "cpu" and bool(with_gpu))
        machines = with_gpu if gpus else machines
        most = max(int(machine.get("CPU", 0)) for machine in machines)
        if cpus > most:
            raise ValueError(f"--cpus {cpus}: no machine of the cluster has more than {most} for each row")
        at_once = sum(int(machine["GPU"] if gpus else machine.get("CPU", 0) // cpus) for machine in machines)
        most, groups = min(LONGEST_BATCH, -(-len(rows) // at_once)), {}
        for row in rows:
            groups.setdefault(row.name if alone else row.shares, []).append(row)
        waiting = [group[k : k + most] for group in groups.values() for k in range(0, len(group), most)][::-1]
        options = {"num_cpus": cpus, "num_gpus": gpus, "max_retries": RETRIES, "max_calls": int(alone)}
        remote = ray.remote(**options)(tried)
        while waiting or running:
            while waiting and len(running) < at_once:
                batch = waiting.pop()
                running[remote.remote(work, batch, os.getcwd())] = batch  # paths mean the same to workers
            done, _ = ray.wait(list(running), timeout=LOOK_EVERY)
            if not done:
                yield None
            for task in done:
                batch = running.pop(task)
                try:
                    yield from ray.get(task)
                except ray.exceptions.RayError as error:
                    if len(batch) > 1:
                        waiting += [[row] for row in batch]
                        continue
                    lost = isinstance(error, ray.exceptions.WorkerCrashedError | ray.exceptions.NodeDiedError)
                    reason = f"its worker was lost {RETRIES + 1} times" if lost else " ".join(str(error).split())
                    yield Outcome(batch[0], reason=reason)
    finally:
        for task in running:
            ray.cancel(task)
        if running:
            ray.wait(list(running), num_returns=len(running), timeout=LETTING_GO)
        ray.shutdown()


def add_address(parser: argparse.ArgumentParser, default: str) -> None:
    """Add `--address`. default: what is used without it."""
    parser.add_argument("--address", metavar="HOST:PORT", help=f"address of a Ray cluster (default: {default})")


def _check_address(address: str | None) -> None:
    """Raises ConnectionError where nothing answers; Ray would try for minutes. Names ("auto") are left to it."""
    host, _, port = (address or "").removeprefix("ray://").rpartition(":")
    if not host:
        return
    try:
        socket.create_connection((host, int(port)), timeout=ANSWER).close()
    except (OSError, ValueError, OverflowError) as error:
        raise ConnectionError(
            f"--address {address}: no Ray cluster answers there ({error}); allowed: HOST:PORT"
        ) from error
