"""The native evaluator agrees with the float64 reference, on every instruction set of this CPU."""

from dataclasses import fields, replace

import numpy as np
import pytest
from native_frames import NativeFrame, clouds, told
from reference.frame import ReferenceFrame
from reference.frame_input import FrameInput
from reference.skinning import skin

from physkin_core import load_motion
from physkin_core.native_module import native
from physkin_core.runtime.bound_garment import BoundGarment
from physkin_core.runtime.evaluator import Skinner, supported_instruction_sets

pytestmark = pytest.mark.usefixtures("exact_network_weights")

LEVELS = supported_instruction_sets()
DETAIL = ("detail_offsets", "detail_nodes", "detail_weights")

ODD = dict(nodes=13, vertices=101, pose_widths=(37, 19, 65), deformer_widths=(33, 7, 50))
SHIPPED = dict(nodes=128, pose_widths=(512,) * 4, deformer_widths=(128,) * 4)
PAPER = SHIPPED | dict(bones=128, dofs=117)
SHAPES = {
    "smallest": dict(bones=1, dofs=0, nodes=1, vertices=1, influences=1, pose_widths=(), deformer_widths=(1,)),
    "no hidden layers": dict(pose_widths=(), deformer_widths=()),
    "odd widths": ODD | dict(bones=7, dofs=11, influences=5),
    "projections": ODD | dict(projections=(0, 2)),
    "block boundary": dict(vertices=64, influences=2, pose_widths=(32,), deformer_widths=(32, 64)),
    "many influences": dict(nodes=40, vertices=333, influences=16),
    "default rig": SHIPPED | dict(bones=36, dofs=52, vertices=2000, influences=8),
    "paper": PAPER | dict(vertices=1500, influences=4),
}


def assert_agrees(out, positions, blended):
    """Within 1e-5 of the garment's size; normals within 1e-5, more where blending all but cancelled them."""
    scale = max(1.0, np.abs(positions).max())
    assert np.abs(out[:, :3] - positions).max() <= 1e-5 * scale
    if out.shape[1] == 6:
        length = np.linalg.norm(blended, axis=1, keepdims=True)
        assert (np.abs(out[:, 3:] - blended / length) * np.minimum(length, 1.0)).max() <= 1e-5


# --- Frames ---


@pytest.mark.parametrize("shape", SHAPES)
def test_a_drape_by_itself_agrees_with_the_reference(shape, make_garment, make_pose):
    """Garment nodes, positions and normals; with and without normals in the output."""
    rng = np.random.default_rng(list(shape.encode()))
    g = make_garment(rng, **SHAPES[shape])
    reference, frames = ReferenceFrame([g]), [NativeFrame([g], instruction_set=level) for level in LEVELS]
    for columns in (6, 3):
        q, gravity = make_pose(rng, g)
        clouds(reference, [g], q, told(gravity))
        nodes = reference.node_transforms()
        for level, frame in zip(LEVELS, frames):
            assert frame.instruction_set == level
            out = np.full((len(g.vertices), columns), np.nan, dtype=np.float32)
            frame.evaluate(q, told(gravity)[None], [out])
            assert np.abs(frame.node_transforms() - nodes).max() <= 1e-5 * max(1.0, np.abs(nodes).max())
            assert_agrees(out, *skin(g, nodes))


@pytest.mark.parametrize("shape, thighs", [("odd widths", [1]), ("many influences", []), ("default rig", [9])])
def test_a_motion_agrees_with_the_reference(shape, thighs, make_garment, make_frames):
    """Frames that are told anything: pace and a sway network, each of which moves the cloth. A bound step gives
    the same bits."""
    rng = np.random.default_rng(list(f"moving {shape}".encode()))
    g = make_garment(rng, **SHAPES[shape], learnt_sway=True)
    g = replace(g, sway_thighs=np.array(thighs, dtype=np.int32))
    reference, frames = ReferenceFrame([g]), [NativeFrame([g], instruction_set=level) for level in LEVELS]
    without = {name: ReferenceFrame([g]) for name in ("passed", "sway")}
    stepped = np.empty((len(g.vertices), 6), dtype=np.float32)
    q_now, row_now, moved = np.zeros(len(g.dof_bone), np.float32), told()[None], dict.fromkeys(without, 0.0)
    step = NativeFrame([g], instruction_set=LEVELS[-1]).bind_frame(q_now, row_now, [stepped])
    for q, row in make_frames(rng, g, 40 if len(g.vertices) < 1000 else 10):
        (expected,) = clouds(reference, [g], q, row)
        for frame in frames:
            (found,) = clouds(frame, [g], q, row)
            assert np.abs(found - expected)[:, :3].max() < 5e-5 * max(1.0, np.abs(expected[:, :3]).max())
        q_now[:], row_now[:] = q, row
        step.step()
        assert (stepped == found).all()
        for name, lesser in without.items():
            row_without = FrameInput.of(row)._replace(**{name: -1.0 if name == "passed" else 0.0}).row()
            moved[name] = max(moved[name], np.abs(clouds(lesser, [g], q, row_without)[0] - expected)[:, :3].max())
    assert min(moved.values()) > 0.01, moved


@pytest.mark.parametrize("columns", [6, 3])
@pytest.mark.parametrize(
    ("shape", "detail_nodes"), (("odd widths", 17), ("many influences", 333), ("default rig", 500))
)
def test_detail_moves_the_rest_garment(shape, detail_nodes, columns, make_garment, make_pose):
    """As in the reference, on every instruction set, also where each vertex is a detail node of its own; whoever skins
    by garment nodes and detail nodes gets the same bits. Garment nodes are those without detail."""
    rng = np.random.default_rng(list(f"detail {shape}".encode()))
    g = make_garment(rng, **SHAPES[shape], detail_nodes=detail_nodes)
    plain = replace(g, detail_layers=(), **{name: np.empty((0, 0), getattr(g, name).dtype) for name in DETAIL})
    q, gravity = make_pose(rng, g)
    reference = ReferenceFrame([g])
    clouds(reference, [g], q, told(gravity))
    positions, normals = skin(g, reference.node_transforms(), reference.detail_offsets())
    for level in LEVELS:
        frame, without = (NativeFrame([each], instruction_set=level) for each in (g, plain))
        assert not frame.detail_offsets().any() and frame.detail_offsets().shape == (detail_nodes, 3)
        out, smooth, skinned = np.full((3, len(g.vertices), columns), np.nan, dtype=np.float32)
        frame.evaluate(q, told(gravity)[None], [out])
        without.evaluate(q, told(gravity)[None], [smooth])
        assert_agrees(out, positions, normals)
        assert (frame.node_transforms() == without.node_transforms()).all()
        assert np.linalg.norm(out - smooth, axis=1).mean() > 0.02
    usual = NativeFrame([g])  # on the instruction set that a Skinner has, which the environment may have chosen
    usual.evaluate(q, told(gravity)[None], [out])
    Skinner(g).skin(usual.node_transforms(), skinned, usual.detail_offsets())
    assert (skinned == out).all() and without.detail_offsets().shape == (0, 3)


@pytest.mark.parametrize("passed", [1 / 60, 0.0])
def test_detail_keeps_its_pace(passed, make_garment, make_pose):
    """No detail node is faster than 2 m/s, which some are kept to and some not; cloud and both kinds of nodes go
    together. Nothing is kept back after a jump or a frame that stands by itself."""
    rng = np.random.default_rng(15)
    g = make_garment(rng, **SHAPES["odd widths"], detail_nodes=17)
    q, gravity = make_pose(rng, g)
    reference, frames = ReferenceFrame([g]), [NativeFrame([g], instruction_set=level) for level in LEVELS]
    shown, kept_back = np.zeros((17, 3)), []
    for k in range(60):
        q = (q + rng.uniform(0, 0.15) * rng.uniform(-1, 1, size=len(q))).astype(np.float32)
        q[0] += 0.6 * (k % 20 == 19)
        row = told(gravity, passed={9: -2.0, 10: -1.0}.get(k % 20, passed))
        before, by_itself = shown, NativeFrame([g])
        clouds(by_itself, [g], q, told(gravity))
        (expected,), shown = clouds(reference, [g], q, row), reference.detail_offsets()
        for frame in frames:
            (found,) = clouds(frame, [g], q, row)
            assert np.abs(frame.detail_offsets() - shown).max() < 1e-4 and np.abs(found - expected)[:, :3].max() < 1e-4
        free = np.linalg.norm(by_itself.detail_offsets() - shown, axis=1) < 1e-4
        if k == 0 or k % 20 in (9, 10, 19):
            assert free.all()
            continue
        moved = np.linalg.norm(shown - before, axis=1)
        assert moved.max() < 2 * passed + 1e-6 and moved[~free] == pytest.approx(2 * passed)
        kept_back.extend(~free)
    assert sum(kept_back) > 100 and (passed == 0 or not all(kept_back))


CONTACTS = {
    "no detail": ("many influences", 0, 20),
    "detail": ("many influences", 60, 20),
    "few blocks": ("block boundary", 40, 7),
    "as many blocks as lanes": ("block boundary", 64, 16),
    "short blocks": ("odd widths", 17, 37),
    "default rig": ("default rig", 500, 60),
}


@pytest.mark.parametrize("contact", CONTACTS)
def test_contact_agrees_with_the_reference(contact, make_garment):
    """On every instruction set, wherever skin lies and whichever side it is on: garment nodes and vertices.

    Cloth is moved by millimetres to centimetres, so that a rule that is not followed shows. Tolerances are those of
    rounding: places are right to some 1e-6 m, and moves of up to 2 cm change with them over distances of 5 mm or more
    (where planes blend, or hold less).
    """
    shape, detail_nodes, skin_blocks = CONTACTS[contact]
    rng = np.random.default_rng(list(f"contact {contact}".encode()))
    g = make_garment(rng, **SHAPES[shape], detail_nodes=detail_nodes, skin_blocks=skin_blocks)
    reference, free = ReferenceFrame([g]), NativeFrame([g.without_contact])
    frames, moved, found_skin = [NativeFrame([g], instruction_set=level) for level in LEVELS], 0.0, 0.0
    for _ in range(6):
        q = (g.dof_rest + rng.normal(size=len(g.dof_rest), scale=0.005)).astype(np.float32)
        row = told(rng.normal((0, 0, -1), 0.02))
        (expected,), (unmoved,) = clouds(reference, [g], q, row), clouds(free, [g], q, row)
        clearance = reference.clearance()
        own = len(g.touching_samples)
        assert len(clearance) == own + (len(g.vertices) if detail_nodes else -(-len(g.vertices) // 2))
        assert own == (48 if detail_nodes else 0) and (not own or (clearance[-own:] < 1).any())
        for frame in frames:
            (found,) = clouds(frame, [g], q, row)
            assert np.abs(frame.node_transforms() - reference.node_transforms()).max() < 2e-5
            assert np.abs(found - expected)[:, :3].max() < 3e-5
        moved = max(moved, np.abs(expected - unmoved)[:, :3].max())
        found_skin = max(found_skin, (clearance < 1).mean())
    assert moved > 0.004 and found_skin > 0.01, (moved, found_skin)


def test_clearance_agrees_with_the_reference(make_garment):
    """Samples that are near no skin are 1 m from it. One in a hundred may be just at the end of reach, near skin for
    the one and not for the other."""
    rng = np.random.default_rng(21)
    g = make_garment(rng, **SHAPES["many influences"], detail_nodes=60, skin_blocks=150)
    reference, frames = ReferenceFrame([g]), [NativeFrame([g], instruction_set=level) for level in LEVELS]
    clouds(reference, [g], g.dof_rest, told())
    expected = reference.clearance()
    assert expected.shape == (333 + 48,) and (expected < 1).sum() > 20 < (expected == 1).sum()
    for frame in frames:
        clouds(frame, [g], g.dof_rest, told())
        agrees = np.abs(frame.clearance() - expected) < 2e-5
        assert agrees.mean() > 0.99, f"{(~agrees).sum()} of 381 differ, {(frame.clearance() == 0).sum()} are 0"


@pytest.mark.parametrize("name", ["tshirt", pytest.param("maxidress", marks=pytest.mark.slow)])
def test_contact_of_shipped_garments_agrees_with_the_reference(name, worn):
    """In motions in which limbs press on the cloth, on every instruction set. Cloth is moved by up to some centimetres
    and agrees a thousand times as well."""
    bound = worn(name).layers[0].bound
    reference, frames = ReferenceFrame([bound]), [NativeFrame([bound], instruction_set=level) for level in LEVELS]
    rig = worn(name).layers[0].model.rig
    for motion, frame_number in (("kick", 45), ("dance", 75), ("cartwheel", 81)):
        motion = load_motion(motion)
        pose, row = motion.positions_for(rig)[frame_number], told(motion.gravity[frame_number])
        (expected,) = clouds(reference, [bound], pose, row)
        for frame in frames:
            assert np.abs(clouds(frame, [bound], pose, row)[0] - expected)[:, :3].max() < 3e-5


@pytest.mark.parametrize("level", LEVELS)
def test_garments_worn_together_agree_with_the_reference(level, make_garment, make_frames):
    """Each with networks and rows of its own."""
    rng = np.random.default_rng(13)
    first, second = make_garment(rng, learnt_sway=True), make_garment(rng, nodes=9, vertices=37)
    names = ("bone_parents", "bone_heads", "dof_bone", "dof_axis", "dof_rest", "dof_lower", "dof_upper")
    bounds = [first, replace(second, **{name: getattr(first, name) for name in names})]
    reference, native = ReferenceFrame(bounds), NativeFrame(bounds, instruction_set=level)
    q_now, rows_now = np.zeros(7, np.float32), np.stack([told()] * 2)
    stepped = [np.empty((len(bound.vertices), 6), np.float32) for bound in bounds]
    step = NativeFrame(bounds, instruction_set=level).bind_frame(q_now, rows_now, stepped)
    for (q, row), (_, other) in zip(make_frames(rng, first, 25), make_frames(rng, first, 25)):
        expected, found = (clouds(frame, bounds, q, row, other) for frame in (reference, native))
        q_now[:], rows_now[:] = q, [row, other]
        step.step()
        for a, b, c in zip(found, expected, stepped):
            assert np.abs(a - b)[:, :3].max() < 5e-5 and (a == c).all()


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("vertices", [1, 5, 15, 16, 17, 40, 210])
def test_skinning_alone_agrees_with_the_reference(vertices, level, make_garment, monkeypatch):
    """A last block of any length; transforms need not be rotations. Positions alone are those written with normals, bit
    for bit. Vertices none of which follows a garment node come to lie at the origin, without normals."""
    monkeypatch.setenv("PHYSKIN_NATIVE_ISA", level)
    rng = np.random.default_rng(vertices)
    g = make_garment(rng, nodes=9, vertices=vertices, influences=1 + vertices % 8)
    transforms = rng.normal(size=(9, 3, 4)).astype(np.float32)
    out, positions = np.empty((vertices, 6), dtype=np.float32), np.empty((vertices, 3), dtype=np.float32)
    for rows in (out, positions):
        Skinner(g).skin(transforms, rows)
    assert_agrees(out, *skin(g, transforms))
    np.testing.assert_array_equal(positions, out[:, :3])
    Skinner(replace(g, influence_weights=np.zeros_like(g.influence_weights))).skin(transforms, out)
    np.testing.assert_array_equal(out, 0)


def test_skinning_alone_checks_what_it_is_given(make_garment):
    rng = np.random.default_rng(9)
    g = make_garment(rng, nodes=11, vertices=137)
    transforms, out = rng.normal(size=(11, 3, 4)).astype(np.float32), np.empty((137, 6), dtype=np.float32)
    skinner = Skinner(g)
    for wrong, error in ((out.astype(np.float64), TypeError), (out[:-1], ValueError), (out[:, ::2], ValueError)):
        with pytest.raises(error):
            skinner.skin(transforms, wrong)
    for bad in (np.nan, np.inf, 1e30):
        transforms[3, 1, 2] = bad
        with pytest.raises(ValueError, match=r"node_transforms\[42\]"):
            skinner.skin(transforms, out)
    with pytest.raises(ValueError, match="node_transforms must have shape"):
        skinner.skin(transforms[1:], out)
    for wrong in (11, -1):
        nodes = g.influence_nodes.copy()
        nodes[5, 0] = wrong
        with pytest.raises(ValueError, match="influence_nodes"):
            Skinner(replace(g, influence_nodes=nodes))


def test_silu_over_its_whole_range(make_garment):
    """Relative error below 1e-6, also where the exponential under- or overflows.

    Each hidden unit's input is its bias and its output goes unchanged into one coordinate of a node's translation.
    """
    inputs = np.r_[np.linspace(-100, 100, 2001), np.logspace(-6, 3, 200), -np.logspace(-6, 5, 202)].astype(np.float32)
    count = len(inputs)
    g = make_garment(
        np.random.default_rng(6), bones=1, dofs=0, nodes=count // 3, pose_widths=(), deformer_widths=(count,)
    )
    for array in (*g.pose_layers[0], *g.deformer_layers[0], g.node_positions):
        array[:] = 0
    g.deformer_layers[0][1][:] = inputs
    output = np.zeros((count // 3, 12, count), dtype=np.float32)
    output[:, 9:] = np.eye(count).reshape(count // 3, 3, count)
    bias = np.zeros(4 * count, dtype=np.float32)
    g = replace(g, deformer_layers=(g.deformer_layers[0], (output.reshape(-1, count), bias)))

    x = inputs.astype(float)
    with np.errstate(over="ignore"):
        expected = x / (1 + np.exp(-x))
    for level in LEVELS:
        evaluator = NativeFrame([g], instruction_set=level)
        clouds(evaluator, [g], np.empty(0, dtype=np.float32), told())
        np.testing.assert_allclose(evaluator.node_transforms()[:, :, 3].ravel(), expected, rtol=1e-6, atol=1e-30)


def test_frames_do_not_interact(make_garment, make_pose):
    """One pose, another, and the first again gives the first result bit for bit, whatever became of the garment."""
    rng = np.random.default_rng(7)
    g = make_garment(rng)
    first, second = ((q, told(gravity)) for q, gravity in (make_pose(rng, g), make_pose(rng, g)))
    frames = [NativeFrame([g], instruction_set=level) for level in LEVELS]
    before = [[clouds(frame, [g], *pose)[0] for pose in (first, second)] for frame in frames]
    for array in (g.vertices, g.bone_heads, g.dof_axis, g.influence_weights, g.pose_layers[0][0]):
        array[:] = np.nan
    for frame, (a, b) in zip(frames, before):
        assert np.array_equal(a, clouds(frame, [g], *first)[0]) and not np.array_equal(a, b)


def test_both_sides_name_the_same_fields():
    """The dataclass and the list that native code reads, checks and loads by."""
    named = sorted(name for name, *_ in native.bound_garment_fields())
    assert named == sorted(field.name for field in fields(BoundGarment) if field.init)
