"""What the native evaluator accepts as output, and what it rejects."""

from dataclasses import replace

import numpy as np
import pytest
from native_frames import NativeFrame, clouds, told

from physkin_core.runtime.evaluator import supported_instruction_sets

# --- A frame: never silently lost, never half written. Rows: test_frame_rows.py; layouts: test_any_step.py. ---


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_joint_that_is_not_finite_raises_and_writes_nothing(bad, make_garment, make_pose):
    """Every joint is named; the last frame stays readable."""
    rng = np.random.default_rng(11)
    garment = make_garment(rng)
    frame, (positions, gravity) = NativeFrame([garment]), make_pose(rng, garment)
    clouds(frame, [garment], positions, told(gravity))
    nodes, out = frame.node_transforms().copy(), np.full((len(garment.vertices), 6), 7, dtype=np.float32)
    for index in range(len(positions)):
        wrong = positions.copy()
        wrong[index] = bad
        with pytest.raises(ValueError, match=rf"joint_positions\[{index}\] is .*finite"):
            frame.evaluate(wrong, told(gravity)[None], [out])
    assert (out == 7.0).all() and np.array_equal(frame.node_transforms(), nodes)


def test_a_frame_that_networks_spoil_leaves_the_last_good_one(make_garment, make_pose):
    """Garment nodes and detail nodes go together: those of two frames make no drape."""
    rng = np.random.default_rng(12)
    garment = make_garment(rng, detail_nodes=9)
    frame, (positions, gravity) = NativeFrame([garment]), make_pose(rng, garment)
    clouds(frame, [garment], positions, told(gravity))
    nodes, offsets = frame.node_transforms(), frame.detail_offsets()
    assert offsets.any()
    for huge in (1e30, 3e38):
        with pytest.raises(ValueError, match="corrections of garment nodes|detail_offsets"):
            clouds(frame, [garment], positions, told(huge * gravity))
        assert np.array_equal(frame.node_transforms(), nodes) and np.array_equal(frame.detail_offsets(), offsets)


def test_a_vanishing_normal_does_not_make_nan(make_garment, make_pose):
    """A zero rest normal stays zero."""
    rng = np.random.default_rng(13)
    garment = make_garment(rng, nodes=1, influences=1)
    garment.normals[4] = 0.0
    positions, gravity = make_pose(rng, garment)
    (out,) = clouds(NativeFrame([garment]), [garment], positions, told(gravity))
    assert np.isfinite(out).all() and not out[4, 3:].any()


# --- Rejections of a garment ---


def changed(array, index, value):
    copy = array.copy()
    copy[index] = value
    return copy


@pytest.mark.parametrize(
    "change, message",
    [
        (lambda g: dict(bone_parents=changed(g.bone_parents, 2, 2)), r"bone_parents\[2\] is 2"),
        (lambda g: dict(bone_parents=changed(g.bone_parents, 2, -2)), r"bone_parents\[2\].* is -2"),
        (lambda g: dict(dof_bone=changed(g.dof_bone, 0, 5)), r"dof_bone\[0\].* is 5"),
        (lambda g: dict(node_bone=changed(g.node_bone, 1, -1)), r"node_bone\[1\].* is -1"),
        (lambda g: dict(deformer_bones=changed(g.deformer_bones, 1, 9)), r"deformer_bones\[1\].* is 9"),
        (lambda g: dict(influence_nodes=changed(g.influence_nodes, (3, 1), 6)), r"influence_nodes\[10\].* is 6"),
        (lambda g: dict(detail_nodes=changed(g.detail_nodes, (3, 1), 9)), r"detail_nodes\[10\].* is 9"),
        (
            lambda g: dict(detail_nodes=g.detail_nodes[:-1], detail_weights=g.detail_weights[:-1]),
            "49 vertices",
        ),
        (lambda g: dict(detail_offsets=g.detail_offsets[:-1]), "26 rows; expected three"),
        (lambda g: dict(detail_layers=()), "detail_layers are 0; expected one"),
        (lambda g: dict(detail_layers=g.deformer_layers[-1:]), "give 72 features; expected 7"),
        (lambda g: dict(dof_upper=g.dof_lower), "must be above its lower limit"),
        (lambda g: dict(vertices=changed(g.vertices, (0, 1), np.nan)), r"vertices\[1\].* is nan"),
        (lambda g: dict(influence_weights=changed(g.influence_weights, (0, 0), np.inf)), "influence_weights.* is inf"),
        (lambda g: dict(vertices=g.vertices.astype(np.float64)), "vertices must be a C-contiguous float32"),
        (lambda g: dict(vertices=np.asfortranarray(g.vertices)), "vertices must be a C-contiguous float32"),
        (lambda g: dict(normals=g.normals[:-1]), r"normals must be .* of shape \(50, 3\)"),
        (lambda g: dict(node_bone=g.node_bone.astype(np.int64)), "node_bone must be a C-contiguous int32"),
        (lambda g: dict(influence_weights=g.influence_weights[:, :2].copy()), r"of shape \(50, 3\)"),
        (lambda g: dict(vertices=g.vertices[:0], normals=g.normals[:0]), "influence_nodes"),
        (lambda g: dict(fabric_weights=changed(g.fabric_weights, 1, 0)), r"fabric_weights\[1\] is 0.*above 0"),
        (lambda g: dict(fabric_weights=g.fabric_weights[:1]), "fabric_weights"),
        (lambda g: dict(fabric_modulations=g.fabric_modulations[:, 1:].copy()), "63 values each; expected a scale and"),
        (lambda g: dict(fabric_sway_shifts=np.zeros((2, 1), dtype=np.float32)), "1 values each; expected 0"),
        (lambda g: dict(pose_layers=()), "pose_layers is empty"),
        (lambda g: dict(pose_layers=g.pose_layers[1:]), r"pose_layers\[0\] has 16 inputs; expected 10"),
        (lambda g: dict(pose_layers=g.pose_layers[:-1]), "pose_layers give 16 values; expected .* 24 hidden"),
        (lambda g: dict(deformer_layers=g.deformer_layers[:-1]), "deformer_layers|pose_layers"),
        (
            lambda g: dict(deformer_layers=(*g.deformer_layers[:-1], tuple(a[:-1] for a in g.deformer_layers[-1]))),
            "deformer_layers give 71 values",
        ),
        (
            lambda g: dict(deformer_layers=((g.deformer_layers[0][0], g.dof_rest), *g.deformer_layers[1:])),
            "bias must be",
        ),
        (lambda g: dict(faces=np.array([[0, 1, 2], [3, 50, 4]], np.int32)), r"faces\[4\].* is 50"),
        (lambda g: dict(faces=np.array([[0, -1, 2]], np.int32)), r"faces\[1\].* is -1"),
    ],
)
def test_malformed_garment_raises_value_error(change, message, make_garment):
    garment = make_garment(np.random.default_rng(14), detail_nodes=9, fabrics=2)
    NativeFrame([garment])
    with pytest.raises(ValueError, match=message):
        NativeFrame([replace(garment, **change(garment))])


SKIN = ("skin_positions", "skin_normals", "skin_bones", "skin_weights")
WITHOUT_DETAIL = {
    "contact_detail_nodes": np.empty((25, 0), np.int32),
    "contact_detail_weights": np.empty((25, 0), np.float32),
    **{f"between_{name}": np.empty((0, 0), kind) for name, kind in (("nodes", np.int32), ("weights", np.float32))},
    **{f"between_{name}": np.empty(0, np.float32) for name in ("heights", "gaps")},
    "between_blocks": np.empty(0, np.int32),
}


@pytest.mark.parametrize(
    "change, message",
    [
        (lambda g: {name: getattr(g, name)[:-1] for name in SKIN}, "23 with 2 bones each; expected a multiple of 8"),
        (
            lambda g: {name: getattr(g, name)[:, :0].copy() for name in SKIN[2:]},
            "24 with 0 bones each; .* with at least one",
        ),
        (lambda g: dict(skin_normals=g.skin_normals[:-1]), r"skin_normals must be .* of shape \(24, 3\)"),
        (lambda g: dict(skin_positions=changed(g.skin_positions, (0, 2), np.nan)), r"skin_positions\[2\].* is nan"),
        (lambda g: dict(skin_bones=changed(g.skin_bones, (1, 0), 5)), r"skin_bones\[2\] is 5; must be in \[0, 5\)"),
        (lambda g: dict(contact_sides=changed(g.contact_sides, (1, 0), 2)), r"contact_sides\[3\] is 2; .* \[-1, 2\)"),
        (lambda g: dict(contact_sides=changed(g.contact_sides, (0, 1), -2)), r"contact_sides\[1\] is -2; .* \[-1, 2\)"),
        (lambda g: dict(contact_sides=g.contact_sides[:, 1:].copy()), "contact_sides are 2 x 2; expected 2 x 3"),
        (
            lambda g: dict(contact_sides=np.concatenate([g.contact_sides] * 2)),
            "contact_sides are 4 x 3; expected 2 x 3",
        ),
        (lambda g: dict(contact_gaps=g.contact_gaps[1:]), r"contact_gaps must be .* of shape \(25,\)"),
        (
            lambda g: dict(contact_influence_nodes=changed(g.contact_influence_nodes, (0, 1), 6)),
            r"contact_influence_nodes\[1\] is 6",
        ),
        (
            lambda g: dict(contact_detail_nodes=changed(g.contact_detail_nodes, (0, 1), 9)),
            r"contact_detail_nodes\[1\] is 9",
        ),
        (lambda g: WITHOUT_DETAIL, "contact_detail_nodes are 0 a sample; .* at least one with detail"),
        (lambda g: dict(between_nodes=changed(g.between_nodes, (1, 0), 9)), r"between_nodes\[3\] is 9"),
        (lambda g: dict(between_weights=g.between_weights[:, 1:].copy()), r"between_weights must be .* \(25, 3\)"),
        (lambda g: dict(between_heights=g.between_heights[1:]), r"between_heights must be .* of shape \(25,\)"),
        (lambda g: dict(between_gaps=changed(g.between_gaps, 3, np.inf)), r"between_gaps\[3\].* is inf"),
        (lambda g: dict(between_blocks=g.between_blocks[:1]), "between_blocks are 1; expected 2"),
        (
            lambda g: dict(touching_samples=changed(g.touching_samples, 3, 25)),
            r"touching_samples\[3\] is 25; .* \[0, 25\)",
        ),
        (lambda g: dict(touching_gaps=g.touching_gaps[1:]), r"touching_gaps must be .* of shape \(48,\)"),
        (lambda g: dict(touching_sides=g.touching_sides[1:].copy()), "touching_sides are 2 x 3; expected one for each"),
        (
            lambda g: dict(touching_samples=g.touching_samples[1:], touching_gaps=g.touching_gaps[1:]),
            "touching_sides are 3 x 3; expected one for each two blocks of 16 of 47 touching_samples",
        ),
        (
            lambda g: dict(touching_sides=changed(g.touching_sides, (0, 1), 3)),
            r"touching_sides\[1\] is 3; .* \[-1, 3\)",
        ),
        (lambda g: dict(between_blocks=changed(g.between_blocks, 1, 2)), r"between_blocks\[1\] is 2; .* \[0, 2\)"),
    ],
)
def test_malformed_contact_raises_value_error(change, message, make_garment):
    garment = make_garment(np.random.default_rng(14), detail_nodes=9, skin_blocks=3)
    NativeFrame([garment])
    with pytest.raises(ValueError, match=message):
        NativeFrame([replace(garment, **change(garment))])


# --- Choice of the instruction set ---


@pytest.mark.parametrize("level", ["baseline", "v3", "v3_vnni", "v4", "v4_vnni", "", None, "v9"])
def test_environment_forces_the_instruction_set(level, make_garment, monkeypatch):
    """Without it, the widest supported one."""
    garment, supported = make_garment(np.random.default_rng(0)), supported_instruction_sets()
    monkeypatch.delenv("PHYSKIN_NATIVE_ISA", raising=False)
    if level is not None:
        monkeypatch.setenv("PHYSKIN_NATIVE_ISA", level)
    if level and level not in supported:
        with pytest.raises(ValueError, match=rf"'{level}' \(from PHYSKIN_NATIVE_ISA\)"):
            NativeFrame([garment])
    else:
        assert NativeFrame([garment]).instruction_set == (level or supported[-1])
    with pytest.raises(ValueError, match="'avx' is unknown or not supported .* supports baseline"):
        NativeFrame([garment], instruction_set="avx")
