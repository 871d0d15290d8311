"""The collision shape follows the body: trunk and limbs, on lean and stout bodies that were not trained on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from physkin_core import DegreeOfFreedom, Rig
from physkin_core.body_shape.limb_chains import find_limbs
from physkin_core.body_shape.radial_shape import fit_radial_shape
from physkin_core.separation.collision_shape import TRUNK, capsule_depth, fit_collision_shape

ONSET = 0.01


def of_bones(avatar, rig, *starts):
    """Skin (V, 3) whose strongest bone begins with one of `starts`."""
    strongest = avatar.influence_bones[np.arange(len(avatar.vertices)), avatar.influence_weights.argmax(axis=1)]
    chosen = [index for index, name in enumerate(rig.bone_names) if name.startswith(starts)]
    return avatar.vertices[np.isin(strongest, chosen)].astype(np.float64)


@pytest.mark.parametrize("body", ["lean", "average", "stout"])
def test_trunk_and_limbs_follow_the_skin(bodies, rig, body):
    """Skin lies on the shape: within 8 mm of the trunk, of limbs within 10 mm, root mean square."""
    avatar = bodies[body]
    shape, warnings = fit_collision_shape(avatar, rig, onset=ONSET)
    assert not warnings and len(shape.limb_kind) == 4
    skin = of_bones(avatar, rig, "spine", "root", "pelvis")
    _, _, low, high = shape.trunk_frame
    skin = skin[(skin[:, 2] > low) & (skin[:, 2] < high - 0.05)]
    depth, normal = shape.trunk.depth(skin)
    assert np.sqrt((depth**2).mean()) < 0.008
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0, atol=0.2)
    centres = shape.sphere_centre.astype(np.float64)
    for index, start in enumerate(("lowerarm0", "lowerleg0")):
        for side in "LR":
            limb = 2 * index + (side == "R")
            skin = of_bones(avatar, rig, f"{start}1.{side}", f"{start}2.{side}")
            depth = capsule_depth(skin, *shape.capsule(3 * limb + 1, centres))[0]
            assert np.sqrt((depth**2).mean()) < 0.014 and abs(depth.mean()) < 0.006


def test_what_touches_at_rest_is_allowed(bodies, rig):
    """No contact begins to count in the canonical pose, however early contacts begin to."""
    onset = 0.1
    shape, _ = fit_collision_shape(bodies["stout"], rig, onset=onset)
    centres = shape.sphere_centre.astype(np.float64)
    at_rest = shape.depths(centres, centres)
    assert (at_rest + onset - shape.allowed).max() < 1e-6
    assert shape.allowed.max() > 0.05
    assert (shape.pairs[:, 1] == TRUNK).sum() == 8


def test_the_trunk_surface_is_smooth():
    """Depth has the slope that its normal says, everywhere: fitted to a cone with a dent, compared with differences."""
    rng = np.random.default_rng(3)
    angle, height = rng.uniform(0, 2 * np.pi, 4000), rng.uniform(-0.3, 0.3, 4000)
    radius = 0.15 + 0.05 * height + 0.02 * np.cos(2 * angle)
    points = np.column_stack([radius * np.cos(angle) + 0.05, radius * np.sin(angle), height])
    shape = fit_radial_shape(points, np.ones(len(points)), -0.3, 0.3)
    assert np.abs(shape.depth(points)[0]).mean() < 0.002
    tried = rng.uniform(-0.5, 0.5, (2000, 3))
    step = 1e-5 * rng.normal(size=tried.shape)
    here, there = shape.depth(tried)[0], shape.depth(tried + step)[0]
    assert np.abs(there - here).max() < 50 * np.linalg.norm(step, axis=1).max()  # no jump
    outside = np.abs(here) < 0.02  # near the surface the first order is the distance
    slope = -(shape.depth(tried)[1] * step).sum(axis=1)
    assert np.abs(there - here - slope)[outside].max() < 0.3 * np.linalg.norm(step, axis=1).max()


def renamed(rig, names):
    """The same rig, other names of bones and joints."""
    bones = dict(zip(rig.bone_names, names))
    dofs = tuple(
        DegreeOfFreedom(f"q{k}", bones[dof.bone], dof.axis, dof.lower, dof.upper, dof.rest)
        for k, dof in enumerate(rig.dofs)
    )
    return Rig(tuple(names), rig.parents, rig.heads, rig.tails, dofs)


def test_limbs_are_found_whatever_the_names(rig):
    """By the names of another naming, and by the skeleton's shape where names say nothing."""
    own = find_limbs(rig)
    assert [limb.name for limb in own.limbs] == ["left arm", "right arm", "left leg", "right leg"] and not own.missing
    assert [rig.bone_names[bone] for bone in own.trunk] == ["root", "spine05", "spine03", "spine02"]
    nameless = find_limbs(renamed(rig, [f"bone_{k}" for k in range(rig.bone_count)]))
    assert [limb.dofs for limb in nameless.limbs] == [limb.dofs for limb in own.limbs]


def test_a_rig_without_limbs_is_refused(rig):
    """With a sentence; one that lacks joints of a single limb is warned of."""
    spine = Rig(
        ("root", "a"),
        np.array([-1, 0]),
        np.zeros((2, 3)),
        np.ones((2, 3)),
        (rig.dofs[0].__class__("a_x", "a", (1, 0, 0), -1, 1),),
    )
    with pytest.raises(ValueError, match="no arm or leg with joints was found"):
        find_limbs(spine)
    stiff = Rig(
        rig.bone_names,
        rig.parents,
        rig.heads,
        rig.tails,
        tuple(dof for dof in rig.dofs if not (dof.bone.startswith(("upperarm", "lowerarm")) and ".L" in dof.bone)),
    )
    assert find_limbs(stiff).missing == ("left arm",)


def test_a_limb_without_skin_is_left_out(bodies, rig):
    """And told of; other limbs are separated."""
    avatar = bodies["average"]
    arm = np.array([rig.bone_index(name) for name in rig.bone_names if "arm0" in name and name.endswith(".L")])
    bones = np.where(np.isin(avatar.influence_bones, arm), rig.bone_index("spine01"), avatar.influence_bones)
    shape, warnings = fit_collision_shape(replace(avatar, influence_bones=bones), rig, onset=ONSET)
    assert len(shape.limb_kind) == 3 and len(warnings) == 1
    assert "left arm is not separated: it has 0 skin points" in warnings[0]
