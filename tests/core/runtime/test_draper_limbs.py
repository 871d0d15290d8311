"""A draper that separates limbs: what it drapes, what it tells, and what it warns of."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from random_models import random_avatar, random_model
from scipy.spatial.transform import Rotation

from physkin_core import UPRIGHT_GRAVITY, AvatarWarning, Draper, LimbSeparator, avatar_from_body, load_body_model
from physkin_core.runtime import body_encoder

pytestmark = pytest.mark.usefixtures("exact_network_weights")


@pytest.fixture(autouse=True)
def few_body_points(monkeypatch):
    """The hyper modulator has tests of its own; here a body is 50 points."""
    monkeypatch.setattr(body_encoder, "POINT_COUNT", 50)


def test_limbs_are_separated_before_draping():
    """The cloth and the bones are those of the separated positions, whichever way the pose comes in."""
    rig = load_body_model().rig
    model = random_model(np.random.default_rng(3), rig=rig)
    avatar = avatar_from_body(load_body_model(), 1.5 * load_body_model().held_out_bodies[55])
    draper = Draper(model, avatar, separate_limbs=True)
    plain = Draper(model, avatar, binding=draper.bound)
    arms_down = rig.joint_positions({"upperarm01.L_x": -0.7, "upperarm01.R_x": 0.7}).astype(np.float32)
    expected, change = LimbSeparator(rig, avatar).separate(arms_down)
    assert change > 0.05
    np.testing.assert_array_equal(draper.separated_positions, rig.rest.astype(np.float32))
    cloth = draper.drape(arms_down)
    np.testing.assert_array_equal(draper.separated_positions, expected)
    np.testing.assert_array_equal(cloth, plain.drape(expected))
    assert not np.allclose(cloth, plain.drape(arms_down), atol=1e-3)
    np.testing.assert_array_equal(draper.bone_transforms(arms_down), plain.bone_transforms(expected))
    turns = {
        bone: Rotation.from_rotvec(angle * rig.dof_axes[rig.joint_names.index(f"{bone}_x")]).as_quat()
        for bone, angle in (("upperarm01.L", -0.7), ("upperarm01.R", 0.7))
    }
    np.testing.assert_allclose(draper.drape_rotations(turns), cloth, atol=1e-5)
    out = np.empty((draper.vertex_count, 6), dtype=np.float32)
    positions, gravity = rig.rest.astype(np.float32), UPRIGHT_GRAVITY.astype(np.float32)
    step = draper.bind_step(positions, gravity, out)
    positions[:] = arms_down
    step()
    np.testing.assert_array_equal(out, cloth)
    np.testing.assert_array_equal(positions, arms_down)
    with pytest.raises(ValueError, match="separates no limbs"):
        _ = plain.separated_positions


def test_limbs_that_are_left_out_are_told():
    """A rig without limbs is refused; a limb without joints is warned of, as everything that binding finds is."""
    rng = np.random.default_rng(5)
    model = random_model(rng)
    avatar = random_avatar(rng, model.rig)
    with pytest.raises(ValueError, match="no arm or leg with joints was found"):
        Draper(model, avatar, separate_limbs=True)
    rig = load_body_model().rig
    stiff = replace(rig, dofs=tuple(dof for dof in rig.dofs if not dof.bone.startswith(("upperleg", "lowerleg"))))
    body = avatar_from_body(load_body_model(), load_body_model().held_out_bodies[0])
    with pytest.warns(AvatarWarning, match="left leg is not separated"):
        draper = Draper(random_model(np.random.default_rng(1), rig=stiff), body, separate_limbs=True)
    assert sum("is not separated" in warning for warning in draper.avatar.warnings) == 2
