"""Engines that do the same on one thread: LiteRT the networks, Warp skinning.

Each is built, its result compared with the native evaluator's in fp32, and only then timed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial

import numpy as np

from physkin_bench.cases import SkinningCase
from physkin_bench.litert_networks import litert_networks

__all__ = ["NETWORK_PEERS", "SKINNING_PEERS", "Peer", "prepare_peers"]

EXACT, ROUNDED = 1e-4, 1e-1
"""Tolerances of fp32 and int8 engines. LiteRT rounds activations to 8 bits, which puts the T-shirt's out by 7 %."""
NORMALS = 5e-3
"""Of unit normals in fp32 where the faces around a vertex nearly cancel out, as of a random model they may."""

Runner = tuple[Callable[[], object], Callable[[], np.ndarray]]
"""One evaluation, inputs and outputs bound, and what gives the result of the last one."""


@dataclass(frozen=True)
class Peer:
    """An engine to compare with. build: takes the case. tolerance: of the result, relative to its largest value."""

    name: str
    build: Callable[..., Runner]
    tolerance: float = EXACT


def _warp(case: SkinningCase) -> Runner:
    from physkin_bench.warp_skinning import warp_skinning

    return warp_skinning(case)


NETWORK_PEERS = (
    Peer("litert_fp32", partial(litert_networks, int8=False)),
    Peer("litert_int8", partial(litert_networks, int8=True), ROUNDED),
)
SKINNING_PEERS = (Peer("warp", _warp, NORMALS),)


def prepare_peers(
    peers: Iterable[Peer], case: object, expected: np.ndarray
) -> tuple[dict[str, Callable[[], object]], dict[str, str]]:
    """Build the peers that are installed and check what they compute.

    Returns what to time by name, and by name why a peer is left out: not installed, failed, or another result.
    """
    calls, missing = {}, {}
    for peer in peers:
        try:
            run, output = peer.build(case)
            run()
            difference = output().astype(np.float64).reshape(expected.shape) - expected
            error = np.abs(difference).max() / np.abs(expected).max()
        except ImportError as reason:
            missing[peer.name] = f"not installed ({reason}); pip install 'physkin[bench]'"
        except Exception as reason:  # a peer must never end the benchmark, whatever it dislikes
            missing[peer.name] = f"failed: {type(reason).__name__}: {str(reason).partition(chr(10))[0]}"
        else:
            if error <= peer.tolerance:
                calls[peer.name] = run
            else:
                missing[peer.name] = f"computes another result: relative error {error:.1e}"
    return calls, missing
