"""Avatars: dispatch by extension, bodies of the compact body model, skinning."""

import numpy as np
import pytest

from physkin_core.avatar.avatar import AvatarError, avatar_from_body
from physkin_core.avatar.body_model import load_body_model
from physkin_core.avatar.loading import load_avatar

BODY = load_body_model()


def test_body_of_the_compact_model():
    """Arrays have the stated shapes and types, the root is at the origin."""
    avatar = avatar_from_body(BODY, BODY.held_out_bodies[3])
    assert avatar.vertices.dtype == avatar.bone_heads.dtype == avatar.influence_weights.dtype == np.float32
    assert avatar.faces.dtype == avatar.influence_bones.dtype == np.int32
    assert avatar.bone_heads.shape == avatar.bone_tails.shape == (BODY.rig.bone_count, 3)
    assert np.allclose(avatar.bone_heads[0], 0, atol=1e-6)
    assert np.allclose(avatar.influence_weights.sum(axis=1), 1, atol=1e-5)
    assert avatar.warnings == ()


def test_posed_vertices_follow_the_bones():
    """At rest nothing moves; a bent elbow moves the hand as its bone and leaves the legs."""
    avatar, rig = avatar_from_body(BODY, BODY.held_out_bodies[0]), BODY.rig
    assert (
        np.abs(avatar.posed_vertices(rig.bone_transforms(rig.rest, heads=avatar.bone_heads)) - avatar.vertices).max()
        < 1e-6
    )
    pose = rig.rest.copy()
    pose[rig.joint_names.index("lowerarm01.L_z")] -= 1.0
    transforms = rig.bone_transforms(pose, heads=avatar.bone_heads)
    posed = avatar.posed_vertices(transforms)
    own = (avatar.influence_weights * (avatar.influence_bones == rig.bone_index("wrist.L"))).sum(axis=1)
    hand, hand_transform = own > 0.9999, transforms[rig.bone_index("wrist.L")]
    expected = avatar.vertices[hand] @ hand_transform[:, :3].T + hand_transform[:, 3]
    assert np.abs(posed[hand] - expected).max() < 1e-4
    legs = avatar.vertices[:, 2] < -0.3
    assert np.abs(posed[legs] - avatar.vertices[legs]).max() < 1e-6
    with pytest.raises(ValueError, match=r"expected \(36, 3, 4\)"):
        avatar.posed_vertices(transforms[:-1])


@pytest.mark.parametrize("coefficients", [np.zeros(47), np.full(48, np.nan), np.zeros((1, 48))])
def test_bad_coefficients_are_refused(coefficients):
    """Shape coefficients must be as many as the model has, and finite."""
    with pytest.raises(AvatarError, match="48 finite numbers"):
        avatar_from_body(BODY, coefficients)


def test_unknown_extension_and_missing_file(tmp_path):
    """The extension decides; the error lists those allowed."""
    (tmp_path / "body.dae").write_bytes(b"x")
    with pytest.raises(AvatarError, match=r"'\.dae' is unknown; allowed: \.glb, \.gltf, \.vrm, \.fbx, \.obj, \.ply"):
        load_avatar(tmp_path / "body.dae", BODY.rig)
    with pytest.raises(AvatarError, match="no such file"):
        load_avatar(tmp_path / "body.glb", BODY.rig)
