"""A frame: joint positions in, clouds of one to four garments out."""

import numpy as np

from reference.contact import clearance, keep_out
from reference.frame_input import FrameInput
from reference.garment_nodes import correct_nodes, pose_nodes
from reference.layer_order import LayerOrder
from reference.networks import last_hidden, mlp, silu
from reference.pace import Pace
from reference.skeleton import bone_transforms, pose_vector
from reference.skinning import face_normals, skin, unit
from reference.sway_network import SwayNetwork

JUMP = 0.5
"""[rad], and of gravity. Where one has moved farther since the last frame, nothing before it counts."""


class ReferenceFrame:
    """Drapes bound garments of one body frame by frame, as they are worn together, the innermost first.

    bounds: `BoundGarment`s. orders: the product's `LayerOrder`s, what keeps every two layers in order.
    Normals are those of the posed mesh; without faces, rest normals are carried along.
    """

    def __init__(self, bounds, orders=()):
        self._garments = [_Garment(bound) for bound in bounds]
        self._orders = [(order.steady, order.yielding, LayerOrder(order)) for order in orders]
        self._last = None

    def evaluate(self, joint_positions, rows, outs):
        """Write one frame. joint_positions: (d,). rows: (g, 13), a `FrameInput` each. outs: of each garment (n, 6), x,
        y, z and unit normal, or (n, 3)."""
        q, inputs = np.asarray(joint_positions, dtype=np.float64), [FrameInput.of(row) for row in rows]
        given = np.stack([np.r_[q, each.gravity] for each in inputs])
        jumps = np.ones(len(given), dtype=bool) if self._last is None else np.abs(given - self._last).max(axis=1) > JUMP
        self._last = given
        layers = []
        for garment, row, jumped in zip(self._garments, inputs, jumps):
            nodes = garment.drape(q, row, jumped)
            positions, normals = skin(garment.bound, nodes, garment.detail_offsets)
            layers.append(np.concatenate([positions, unit(normals)], axis=1))
        for outer in range(len(layers)):
            for steady, yielding, order in self._orders:
                if max(steady, yielding) == outer:
                    passed = -1.0 if jumps.any() else inputs[yielding].passed
                    order.apply(layers[steady], layers[yielding], look_at_all=jumps.any(), passed=passed)
        for garment, layer, out in zip(self._garments, layers, outs):
            if len(garment.bound.faces):
                layer[:, 3:] = face_normals(layer[:, :3], garment.bound.faces)
            out[:] = layer[:, : out.shape[1]]

    def node_transforms(self, garment=0):
        """chi (m, 3, 4) of a garment in the last frame."""
        return self._garments[garment].nodes

    def detail_offsets(self, garment=0):
        """(D, 3) of the detail nodes of a garment in the last frame; (0, 3) without detail."""
        return self._garments[garment].detail_offsets

    def clearance(self, garment=0):
        """(s + t,) [m] how far a garment was from the skin in the last frame."""
        of = self._garments[garment]
        return clearance(of.bound, of.bones, of.nodes, of.detail_offsets)

    def corrections(self, garment=0):
        """(12 m,) what the networks made of a garment in the last frame."""
        return self._garments[garment].corrections


class _Garment:
    """A bound garment and what it remembers."""

    def __init__(self, bound):
        self.bound, self._pace = bound, Pace()
        self._sway = SwayNetwork(bound) if bound.sway_layers else None

    def drape(self, q, row, jumped):
        """chi (m, 3, 4)."""
        bound = self.bound
        skeleton = bound.bone_parents, bound.bone_heads, bound.dof_bone, bound.dof_axis
        bones = bone_transforms(*skeleton, q - bound.dof_rest)
        modulation = mlp(bound.pose_layers, pose_vector(q, bound.dof_lower, bound.dof_upper, row.gravity))
        inputs = bones[bound.deformer_bones].reshape(-1)
        self.corrections = mlp(bound.deformer_layers, inputs, modulation)
        passed, offsets = -1.0 if jumped else row.passed, np.zeros((0, 3))
        for weight, bias in bound.detail_layers:
            features = silu(weight @ last_hidden(bound.deformer_layers, inputs, modulation) + bias)
            offsets = (bound.detail_offsets.astype(np.float64) @ features).reshape(-1, 3)
        if self._sway is not None:
            if row.sway > 0:
                self.corrections = self.corrections + row.sway * self._sway.share(bones) * self._sway.offsets(q, row)
            else:
                self._sway.forget()
        posed = pose_nodes(bones, bound.node_bone, bound.node_positions.astype(np.float64))
        nodes = correct_nodes(posed, self.corrections)
        nodes, offsets = self._pace.kept(posed, nodes, offsets, passed)
        self.bones = bones
        self.nodes, self.detail_offsets = keep_out(bound, bones, nodes, offsets)
        return self.nodes
