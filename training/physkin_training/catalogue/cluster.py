"""Jobs on a Ray cluster: each on a GPU, or on processor cores where there is none. Ray retries lost workers."""

from __future__ import annotations

import logging
import os
import socket
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

from physkin_training.catalogue.garment_run import train_garment
from physkin_training.catalogue.plan import Job, Status, read_status, write_status

__all__ = ["Cluster", "joined"]

LETTING_GO = 60.0
"""Time [s] that trainings get to write a checkpoint when all is stopped."""
ANSWER = 5.0
"""Time [s] that a cluster gets to answer."""
RETRIES = 3
"""New attempts for a garment whose worker was lost."""


@dataclass(frozen=True)
class Cluster:
    """cpus, gpus: what a training gets. at_once: most trainings at a time."""

    cpus: int
    gpus: int
    at_once: int

    @property
    def device(self) -> str:
        """Where garments are trained."""
        return "cuda" if self.gpus else "cpu"

    def run(self, jobs: Sequence[Job], *, look_every: float) -> Iterator[tuple[Job, Status] | None]:
        """Every job with how it ended, as they end; None every `look_every` seconds in which none has.

        When the caller stops listening, running trainings write a checkpoint, and no further ones begin.
        """
        import ray

        # A process a garment: what one leaves behind, in memory or of a crash, no other one sees.
        remote = ray.remote(num_cpus=self.cpus, num_gpus=self.gpus, max_retries=RETRIES, max_calls=1)(train_garment)
        waiting, running = list(reversed(jobs)), {}
        try:
            while waiting or running:
                while waiting and len(running) < self.at_once:
                    job = waiting.pop()
                    running[remote.remote(job, self.device)] = job
                done, _ = ray.wait(list(running), timeout=look_every)
                if not done:
                    yield None
                for task in done:
                    job = running.pop(task)
                    yield job, self._outcome(ray, task, job)
        finally:
            for task in running:
                ray.cancel(task)
            if running:
                ray.wait(list(running), num_returns=len(running), timeout=LETTING_GO)

    def _outcome(self, ray, task, job: Job) -> Status:
        try:
            return ray.get(task)
        except ray.exceptions.RayError as error:
            lost = isinstance(error, ray.exceptions.WorkerCrashedError | ray.exceptions.NodeDiedError)
            reason = f"its worker was lost {RETRIES + 1} times" if lost else " ".join(str(error).split())
            noted = read_status(job)
            status = Status(job.fingerprint, "failed", reason, noted.starts if noted else 0)
            write_status(job, status)
            return status


@contextmanager
def joined(address: str | None, *, cpus: int, device: str | None = None) -> Iterator[Cluster]:
    """The Ray cluster at an address; without one, what `RAY_ADDRESS` names or runs on this machine, else one is started
    here and ended with the block.

    cpus: cores a training. device: "cpu" to leave GPUs alone, None for one GPU a training where there are any. Raises
    ModuleNotFoundError without Ray, ConnectionError where no cluster answers, ValueError where no machine has so many
    cores or a GPU.
    """
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # nothing is reported to anybody
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
    os.environ.setdefault("RAY_DEDUP_LOGS_SKIP_REGEX", ".")  # Ray tells of a lost worker in forty lines
    import ray

    _check_address(address)
    ray.init(address=address, log_to_driver=False, logging_level=logging.ERROR)
    try:
        machines = [node["Resources"] for node in ray.nodes() if node["Alive"]]
        gpus = 1 if device != "cpu" and any(machine.get("GPU", 0) >= 1 for machine in machines) else 0
        if device == "cuda" and not gpus:
            raise ValueError("--device cuda: no machine of the cluster has a GPU; allowed: cpu")
        room = [int(machine.get("CPU", 0)) for machine in machines if machine.get("GPU", 0) >= gpus]
        if cpus > max(room):
            raise ValueError(f"--cpus {cpus}: no machine of the cluster has more than {max(room)} for a training")
        fits = sum(
            int(min(machine.get("CPU", 0) // cpus, machine["GPU"] if gpus else machine.get("CPU", 0)))
            for machine in machines
            if machine.get("GPU", 0) >= gpus
        )
        yield Cluster(cpus, gpus, fits)
    finally:
        ray.shutdown()


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
