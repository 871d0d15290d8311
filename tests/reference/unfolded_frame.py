"""A drape as paper and design state it: a garment model on a body, nothing folded or carried over when it is bound."""

import numpy as np

from reference.garment_nodes import correct_nodes, pose_nodes
from reference.networks import last_hidden, linear, mlp, silu
from reference.skeleton import bone_transforms, pose_vector


def unfolded_nodes(model, bones, node_positions, modulation, theta):
    """chi (m, 3, 4). bones: (b, 3, 4) of the body; node_positions: (m, 3) garment nodes on it; modulation: (s,) of the
    body, from the hyper modulator; theta: the pose vector."""
    posed = pose_nodes(bones, model.node_bone, node_positions)
    by_pose = mlp(model.pose_modulator, theta, modulation)
    return correct_nodes(posed, mlp(model.node_deformer, posed.reshape(-1), by_pose))


def unfolded_drape(model, avatar, modulation, joint_positions, gravity):
    """chi (m, 3, 4) on an avatar: garment nodes keep their offset from their bone, by the ratio of bone lengths."""
    return unfolded_nodes(model, *_posed(model, avatar, modulation, joint_positions, gravity))


def unfolded_offsets(model, avatar, modulation, joint_positions, gravity):
    """Of the same, offsets of detail nodes (D, 3); () of a model without detail."""
    if model.detail is None:
        return ()
    bones, carried, modulation, theta = _posed(model, avatar, modulation, joint_positions, gravity)
    posed = pose_nodes(bones, model.node_bone, carried)
    by_pose = mlp(model.pose_modulator, theta, modulation)
    features = silu(linear(model.detail.features, last_hidden(model.node_deformer, posed.reshape(-1), by_pose)))
    return (model.detail.offsets.astype(np.float64) @ features).reshape(-1, 3)


def _posed(model, avatar, modulation, joint_positions, gravity):
    """Bones, garment nodes on the avatar, modulation and pose vector."""
    rig, q = model.rig, np.asarray(joint_positions, dtype=np.float64)
    lengths = np.linalg.norm(rig.tails - rig.heads, axis=1)
    ratio = (np.linalg.norm(avatar.bone_tails - avatar.bone_heads, axis=1) / lengths)[model.node_bone, None]
    carried = avatar.bone_heads[model.node_bone] + ratio * (model.node_rest - rig.heads[model.node_bone])
    bones = bone_transforms(rig.parents, avatar.bone_heads, rig.dof_bones, rig.dof_axes, q - rig.rest)
    return bones, carried, modulation, pose_vector(q, rig.lower, rig.upper, gravity)
