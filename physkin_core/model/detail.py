"""Detail: folds that garment nodes are too few for, as offsets of the rest garment, added before it is skinned.

Features of a frame come from the node deformer's last hidden layer. They move detail nodes, points of the rest garment
that only shift; a vertex goes with the few nearest to it. Skinning then turns the offsets with the cloth.

Dimensions: `n` vertices, `D` detail nodes, `J` of them a vertex, `F` features, `h` node deformer width. Metres,
canonical pose.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from physkin_core.model.mlp import Layer
from physkin_core.model.model_arrays import Array, Linear, described

__all__ = ["Detail"]


@dataclass(frozen=True)
class Detail:
    """Checked by the `GarmentModel` that it is part of.

    features: (F, h), followed by SiLU. offsets: (3 D, F) [m], what a feature of 1 adds to x, y and z of each detail
    node. nodes: (n, J) index of the detail nodes that a vertex goes with; weights: (n, J), rows sum to 1.
    """

    features: Layer = described("features", Linear("F", "deformer_width"))
    offsets: np.ndarray = described("offsets.weight", Array("3detail_nodes F"))
    nodes: np.ndarray = described("nodes", Array("n J", below="detail_nodes"))
    weights: np.ndarray = described("weights", Array("n J", step=1 / 511, sums_to_one=True))
