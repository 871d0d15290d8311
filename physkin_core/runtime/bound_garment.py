"""A garment model bound to one body: everything the per-frame path needs, nothing that changes with the pose.

Dimensions: `b` bones, `d` degrees of freedom, `p = d + 3` pose vector, `m` garment nodes, `n` garment vertices,
`K` influences a vertex, `h` node deformer width, `u` bones that garment nodes follow, `w` oscillators. All float arrays
are float32 and C-contiguous; lengths in metres, angles in radians, root frame.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace

import numpy as np

from physkin_core.model.garment_nodes import pose_nodes
from physkin_core.model.mlp import Layer
from physkin_core.model.skinning import SkinningData, skinning_matrices
from physkin_core.native_module import native
from physkin_core.rig.linear_blend_skinning import linear_blend_skinning

__all__ = ["BoundGarment", "plain_skinning"]


@dataclass(frozen=True, kw_only=True)
class BoundGarment(SkinningData):
    """Constant arrays of the per-frame path for one (garment model, body) pair, those of `SkinningData` among them.

    native/src/garment/bound_garment.cpp lists the same fields with their types: `native.bound_garment_fields`.
    The evaluator, the bound garment file and `of_vertices` follow that list.

    bone_parents: (b,) int32, parent before child, -1 for the root.
    bone_heads: (b, 3) joint centres of this body at the canonical pose.
    dof_bone: (d,) int32; dof_axis: (d, 3) unit; dof_rest, dof_lower, dof_upper: (d,).
    pose_layers: pose modulator as (network weight (out, in), bias (out,)), the body's modulation folded in; hidden
        layers are followed by SiLU, the last layer is linear and gives the node deformer's modulation
        [scale_0 (h), shift_0 (h), scale_1, shift_1, ...]. A layer with an empty bias is a projection, W x alone.
    fabric_pose_layers, fabric_modulations, fabric_weights, fabric_sway_shifts: other fabrics that a host can have it
        made of instead, or none. The pose modulator of these; scale and shift for every hidden unit of it, over what
        is folded in (F, M); how many times as heavy (F,); what is added to the first hidden layer of both parts of the
        sway network (F, S). See `physkin_core.runtime.other_fabrics`.
    deformer_bones: (u,) int32, the bones whose transforms feed the node deformer.
    deformer_layers: node deformer; the first network weight is (h, 12 u) over the row-major (3, 4) bone transforms,
        hidden layer k is SiLU((1 + scale_k) * (W x + bias) + shift_k), the last layer is linear and
        gives 12 m numbers.
    detail_layers: one layer (F, h) from the node deformer's last hidden layer to features, followed by SiLU; none of a
        garment without detail.
    detail_offsets: (3 D, F) [m], what a feature of 1 adds to x, y and z of each detail node; gives `detail_node_count`.
    node_bone: (m,) int32, the bone each garment node follows.
    node_positions: (m, 3) garment nodes at the canonical pose of this body.
    sway_joints, sway_layers, sway_rates, sway_turns: the sway network, the body's code folded in, or all empty. Joints
        (j,) int32 that it looks at; rates and turns (w,) of its oscillators; two layers from the drive to what drives
        and gates these (3 w), SiLU between, and three from states, pose and drive to offsets (12 m), SiLU between.
    sway_thighs: (t,) int32, bones on which cloth lies where they are raised; it then sways less.
    skin_positions, skin_normals: (q, 3) points of the skin at the canonical pose, in blocks of 8, and unit normals;
        skin_bones, skin_weights (q, S) that they follow. contact_vertices, contact_normals (s, 3),
        contact_influence_nodes, contact_influence_weights (s, K), contact_detail_nodes, contact_detail_weights (s, J):
        samples of the cloth that is kept out of it, as vertices are given; (s, 0) without detail. contact_gaps (s,)
        [m]: what each keeps off; contact_hangs (s,): how free each hangs, 0 to 1. contact_sides: int32, for each block
        of 16 samples and each of the skin 1 where the skin is beneath the cloth, -1 where it presses on it.
        between_nodes, between_weights (t, J): vertices between these samples, by the detail nodes they go with;
        between_heights (t,) [m] off the mean of those nodes' samples; between_gaps (t,); between_blocks: int32, for
        each block of 16 the block of samples whose sides it has. touching_samples (k,) int32, in blocks of 16: those
        that may touch far places of the cloth; touching_gaps (k,) [m] that each keeps off these; touching_sides: int32,
        for each two blocks -1 where they press on each other, where they overlap as made 1 if the second lies beneath
        the first and 2 if over it, or 0. All empty where nothing is kept out.
    """

    bone_parents: np.ndarray
    bone_heads: np.ndarray
    dof_bone: np.ndarray
    dof_axis: np.ndarray
    dof_rest: np.ndarray
    dof_lower: np.ndarray
    dof_upper: np.ndarray
    pose_layers: tuple[Layer, ...]
    deformer_bones: np.ndarray
    deformer_layers: tuple[Layer, ...]
    node_bone: np.ndarray
    node_positions: np.ndarray
    fabric_pose_layers: tuple[Layer, ...] = ()
    fabric_modulations: np.ndarray = field(default_factory=lambda: np.empty((0, 0), dtype=np.float32))
    fabric_weights: np.ndarray = field(default_factory=lambda: np.empty(0, dtype=np.float32))
    fabric_sway_shifts: np.ndarray = field(default_factory=lambda: np.empty((0, 0), dtype=np.float32))
    detail_layers: tuple[Layer, ...] = ()
    detail_offsets: np.ndarray = field(default_factory=lambda: np.empty((0, 0), dtype=np.float32))
    detail_node_count: int = field(init=False)
    sway_joints: np.ndarray = field(default_factory=lambda: np.empty(0, dtype=np.int32))
    sway_layers: tuple[Layer, ...] = ()
    sway_rates: np.ndarray = field(default_factory=lambda: np.empty(0, dtype=np.float32))
    sway_turns: np.ndarray = field(default_factory=lambda: np.empty(0, dtype=np.float32))
    sway_thighs: np.ndarray = field(default_factory=lambda: np.empty(0, dtype=np.int32))
    skin_positions: np.ndarray = field(default_factory=lambda: np.empty((0, 3), dtype=np.float32))
    skin_normals: np.ndarray = field(default_factory=lambda: np.empty((0, 3), dtype=np.float32))
    skin_bones: np.ndarray = field(default_factory=lambda: np.empty((0, 1), dtype=np.int32))
    skin_weights: np.ndarray = field(default_factory=lambda: np.empty((0, 1), dtype=np.float32))
    contact_vertices: np.ndarray = field(default_factory=lambda: np.empty((0, 3), dtype=np.float32))
    contact_normals: np.ndarray = field(default_factory=lambda: np.empty((0, 3), dtype=np.float32))
    contact_influence_nodes: np.ndarray = field(default_factory=lambda: np.empty((0, 1), dtype=np.int32))
    contact_influence_weights: np.ndarray = field(default_factory=lambda: np.empty((0, 1), dtype=np.float32))
    contact_detail_nodes: np.ndarray = field(default_factory=lambda: np.empty((0, 0), dtype=np.int32))
    contact_detail_weights: np.ndarray = field(default_factory=lambda: np.empty((0, 0), dtype=np.float32))
    contact_gaps: np.ndarray = field(default_factory=lambda: np.empty(0, dtype=np.float32))
    contact_hangs: np.ndarray = field(default_factory=lambda: np.empty(0, dtype=np.float32))
    contact_sides: np.ndarray = field(default_factory=lambda: np.empty((0, 0), dtype=np.int32))
    between_nodes: np.ndarray = field(default_factory=lambda: np.empty((0, 0), dtype=np.int32))
    between_weights: np.ndarray = field(default_factory=lambda: np.empty((0, 0), dtype=np.float32))
    between_heights: np.ndarray = field(default_factory=lambda: np.empty(0, dtype=np.float32))
    between_gaps: np.ndarray = field(default_factory=lambda: np.empty(0, dtype=np.float32))
    between_blocks: np.ndarray = field(default_factory=lambda: np.empty(0, dtype=np.int32))

    touching_samples: np.ndarray = field(default_factory=lambda: np.empty(0, dtype=np.int32))
    touching_gaps: np.ndarray = field(default_factory=lambda: np.empty(0, dtype=np.float32))
    touching_sides: np.ndarray = field(default_factory=lambda: np.empty((0, 0), dtype=np.int32))

    def __post_init__(self) -> None:
        object.__setattr__(self, "detail_node_count", len(self.detail_offsets) // 3)

    @property
    def without_contact(self) -> BoundGarment:
        """The same, but not kept out of the skin: as the networks alone drape it."""
        prefixes = "contact_", "between_", "skin_", "touching_"
        contact = [each for each in fields(self) if each.name.startswith(prefixes)]
        return replace(self, **{each.name: each.default_factory() for each in contact})

    def of_vertices(self, vertices: np.ndarray, faces: np.ndarray) -> BoundGarment:
        """The same of which only some vertices (v,) are computed; faces (f, 3) int32 of these."""
        arrays = {name: getattr(self, name) for name, _, per_vertex in native.bound_garment_fields() if per_vertex}
        kept = {name: np.ascontiguousarray(array[vertices]) for name, array in arrays.items() if len(array)}
        return replace(self, faces=faces, **kept)


def plain_skinning(bound: BoundGarment, bone_transforms: np.ndarray) -> np.ndarray:
    """The garment as its garment nodes carry it without any correction: what a model's drape is compared with.

    bone_transforms: (b, 3, 4) of this body, from `Draper.bone_transforms`. Returns (n, 3).
    """
    nodes = pose_nodes(bone_transforms, bound.node_bone, bound.node_positions)
    matrices = skinning_matrices(nodes, bound.node_rest)
    return linear_blend_skinning(bound.vertices, matrices, bound.influence_nodes, bound.influence_weights)
