"""What peers of networks and of skinning have in common: they are built, checked, and only then timed."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

import numpy as np

__all__ = ["Peer", "Runner", "hold_blas_to_one_thread", "installed_versions", "prepare_peers"]

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Runner:
    """A peer ready to be timed. run: one evaluation, inputs and outputs bound. output: result of the last one."""

    run: Callable[[], object]
    output: Callable[[], np.ndarray]


@dataclass(frozen=True)
class Peer:
    """An engine to compare with. build: takes the case. tolerance: of the result, relative to its largest value."""

    name: str
    packages: tuple[str, ...]
    build: Callable[..., Runner]
    tolerance: float


def prepare_peers(
    peers: Iterable[Peer], case: object, expected: np.ndarray
) -> tuple[dict[str, Callable[[], object]], dict[str, str]]:
    """Build the peers that are installed and check what they compute.

    Returns what to time by name, and by name why a peer is left out: not installed, failed, or another result.
    """
    calls, missing = {}, {}
    largest = np.abs(expected).max()
    for peer in peers:
        try:
            runner = peer.build(case)
            runner.run()
            error = float(np.abs(runner.output().astype(np.float64).reshape(expected.shape) - expected).max() / largest)
        except ImportError as reason:
            missing[peer.name] = f"not installed ({reason}); pip install 'physkin[bench]'"
        except Exception as reason:  # a peer must never end the benchmark, whatever it dislikes
            missing[peer.name] = f"failed: {type(reason).__name__}: {str(reason).partition(chr(10))[0]}"
        else:
            if error <= peer.tolerance:
                calls[peer.name] = runner.run
            else:
                missing[peer.name] = f"computes another result: relative error {error:.1e}"
    for name, reason in missing.items():
        log.info("peer %s left out: %s", name, reason)
    return calls, missing


def hold_blas_to_one_thread() -> None:
    """Of NumPy and scipy, for the rest of the process. Raises ImportError where threadpoolctl is not installed."""
    from threadpoolctl import threadpool_limits

    threadpool_limits(limits=1)


def installed_versions(peers: Iterable[Peer]) -> Mapping[str, str]:
    """Version of every installed distribution that the peers use."""
    from importlib.metadata import PackageNotFoundError, version

    versions = {}
    for package in sorted({package for peer in peers for package in peer.packages}):
        try:
            versions[package] = version(package)
        except PackageNotFoundError:
            continue
    return versions
