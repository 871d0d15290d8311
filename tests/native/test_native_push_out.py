"""The native push-out against its NumPy reference, on every instruction set of this CPU."""

from dataclasses import fields, replace

import numpy as np
import pytest

from physkin_core.rig.rig import forward_kinematics
from physkin_core.runtime.push_out import BLOCK, PATCH, BoundPushOut
from physkin_core.runtime.reference_evaluator import ReferenceEvaluator

pytestmark = pytest.mark.usefixtures("exact_network_weights")

native_evaluator = pytest.importorskip("physkin_core.runtime.native_evaluator")
NativeEvaluator = native_evaluator.NativeEvaluator
SETS = native_evaluator.supported_instruction_sets()


def random_push_out(rng, garment, pose, gravity, *, size, influences=3):
    """A body of small random triangles that in the given pose lie where the garment does, so that much is in contact.

    Blocks of any length and candidates of any number, none included.
    """
    vertices = len(garment.vertices)
    cloth = np.empty((vertices, 6), dtype=np.float32)
    ReferenceEvaluator(garment).evaluate(pose, gravity, cloth)
    bones = forward_kinematics(
        garment.bone_parents, garment.bone_heads, garment.dof_bone, garment.dof_axis, pose - garment.dof_rest
    )
    seats = rng.choice(vertices, size=size)
    corners = cloth[seats, None, :3] + rng.normal(scale=0.02, size=(size, 3 * PATCH, 3))
    posed = np.concatenate([corners.mean(axis=1), corners.reshape(-1, 3)])
    normals = np.repeat(rng.normal(size=(size, 3)), 3 * PATCH, axis=0) + 0.2 * rng.normal(size=(size * 3 * PATCH, 3))
    outward = np.concatenate([normals[:: 3 * PATCH], normals])
    body_bones = rng.integers(0, len(bones), size=(len(posed), influences))
    body_weights = rng.dirichlet(np.full(influences, 0.3), size=len(posed))
    blend = np.einsum("vk,vkij->vij", body_weights, bones[body_bones])
    back = np.linalg.inv(blend[..., :3] + 1e-3 * np.eye(3))
    turned = np.einsum("vij,vj->vi", back, outward)

    left, blocks = list(rng.permutation(vertices)), []
    while left:
        count = min(len(left), rng.integers(1, BLOCK + 1))
        blocks.append([left.pop() if k < count else -1 for k in range(BLOCK)])
    listed = [rng.choice(size, size=rng.integers(0, size + 1), replace=False) for _ in blocks]
    return BoundPushOut(
        body_vertices=np.einsum("vij,vj->vi", back, posed - blend[..., 3]).astype(np.float32),
        body_normals=(turned / np.linalg.norm(turned, axis=1, keepdims=True)).astype(np.float32),
        body_bones=body_bones.astype(np.int32),
        body_weights=body_weights.astype(np.float32),
        body_bend=rng.uniform(-3, 3, size=size).astype(np.float32),
        body_patch=(size + np.arange(size * PATCH * 3)).reshape(size, PATCH, 3).astype(np.int32),
        block_vertices=np.array(blocks, dtype=np.int32),
        candidate_start=np.cumsum([0, *map(len, listed)]).astype(np.int32),
        candidates=np.concatenate(listed).astype(np.int32),
    )


@pytest.fixture
def in_contact(make_garment, make_pose):
    """A garment, its push-out, and the joint positions and gravity in which the two are in contact."""

    def make(rng, *, vertices=50, size=20):
        garment = make_garment(rng, vertices=vertices)
        pose, gravity = make_pose(rng, garment)
        return garment, random_push_out(rng, garment, pose, gravity, size=size), pose, gravity

    return make


@pytest.mark.parametrize("instruction_set", SETS)
@pytest.mark.parametrize("sizes", [(1, 1), (15, 3), (16, 8), (17, 5), (50, 20), (333, 61)], ids=str)
def test_agrees_with_the_reference(instruction_set, sizes, in_contact):
    """Positions, normals and residual, for all but a few vertices where rounding decides between two triangles."""
    rng = np.random.default_rng(sum(sizes))
    moved = wrong = 0
    for _ in range(6):
        garment, push_out, pose, gravity = in_contact(rng, vertices=sizes[0], size=sizes[1])
        native = NativeEvaluator(garment, instruction_set=instruction_set, push_out=push_out)
        reference = ReferenceEvaluator(garment, push_out=push_out)
        out, expected, before = (np.empty((sizes[0], 6), dtype=np.float32) for _ in range(3))
        native.evaluate(pose, gravity, out)
        reference.evaluate(pose, gravity, expected)
        ReferenceEvaluator(garment).evaluate(pose, gravity, before)
        moved += int((np.abs(expected - before)[:, :3].max(axis=1) > 1e-4).sum())
        tolerance = [2e-4] * 3 + [1e-3] * 3  # normals take on the body's, poor where its blend is flat
        off = (np.abs(out - expected) > tolerance).any(axis=1)
        wrong += int(off.sum())
        if not off.any():
            assert native.residual.deepest == pytest.approx(reference.residual.deepest, abs=1e-4)
            assert abs(native.residual.left_inside - reference.residual.left_inside) <= 1
    assert wrong <= 0.03 * moved
    assert moved > 0.02 * 6 * sizes[0]


@pytest.mark.parametrize("instruction_set", SETS)
def test_any_rows_get_the_same_vertices(instruction_set, in_contact):
    """Positions alone, rows far apart, rows off alignment and rows backwards: the same positions bit for bit."""
    rng = np.random.default_rng(4)
    garment, push_out, pose, gravity = in_contact(rng, vertices=200, size=40)
    native = NativeEvaluator(garment, instruction_set=instruction_set, push_out=push_out)
    full = np.empty((200, 6), dtype=np.float32)
    native.evaluate(pose, gravity, full)
    residual = native.residual
    message = np.frombuffer(bytearray(4 * (200 * 11) + 1), dtype=np.uint8)[1:].view(np.float32).reshape(200, 11)
    for rows in (np.empty((200, 3), dtype=np.float32), message[:, 2:8], message[:, 5:8], message[::-1, :6]):
        native.evaluate(pose, gravity, rows)
        np.testing.assert_array_equal(rows[:, :3], full[:, :3])
        assert native.residual == residual


@pytest.mark.parametrize("precision", native_evaluator.PRECISIONS)
def test_a_bound_step_is_the_same_frame(precision, in_contact):
    """A bound step pushes out too, bit for bit, also stage by stage; a refused pose keeps vertices and residual."""
    rng = np.random.default_rng(11)
    garment, push_out, pose, gravity = in_contact(rng, vertices=200, size=40)
    native = NativeEvaluator(garment, precision=precision, push_out=push_out)
    expected, skinned, out = (np.zeros((200, 6), dtype=np.float32) for _ in range(3))
    native.evaluate(pose, gravity, expected)
    residual = native.residual
    native.skin(native.node_transforms(), skinned)
    assert (skinned != expected).any()
    q = pose.astype(np.float32)
    bound = native.bind_step(q, gravity.astype(np.float32), out)
    native.evaluate(np.zeros_like(pose), gravity, skinned)
    bound.step()
    np.testing.assert_array_equal(out, expected)
    assert native.residual == residual
    out[:] = 0
    bound.skin()
    bound.push_out()
    np.testing.assert_array_equal(out, expected)
    q[0] = np.nan
    with pytest.raises(ValueError, match="joint_positions"):
        bound.step()
    np.testing.assert_array_equal(out, expected)
    assert native.residual == residual


def test_without_push_out_nothing_is_left(in_contact):
    """The residual is zero, and `skin` alone never pushes."""
    rng = np.random.default_rng(5)
    garment, push_out, pose, gravity = in_contact(rng)
    plain, pushing = NativeEvaluator(garment), NativeEvaluator(garment, push_out=push_out)
    out, skinned, pushed = (np.empty((50, 6), dtype=np.float32) for _ in range(3))
    plain.evaluate(pose, gravity, out)
    assert (plain.residual.deepest, plain.residual.left_inside) == (0, 0)
    pushing.evaluate(pose, gravity, pushed)
    pushing.skin(pushing.node_transforms(), skinned)
    np.testing.assert_array_equal(skinned, out)
    assert (pushed != out).any()


@pytest.mark.parametrize("instruction_set", SETS)
def test_arrays_are_copied(instruction_set, in_contact):
    """Overwriting the caller's arrays changes nothing."""
    rng = np.random.default_rng(6)
    garment, push_out, pose, gravity = in_contact(rng)
    native = NativeEvaluator(garment, instruction_set=instruction_set, push_out=push_out)
    before, after = (np.empty((50, 6), dtype=np.float32) for _ in range(2))
    native.evaluate(pose, gravity, before)
    for field in fields(push_out):
        getattr(push_out, field.name)[:] = 0
    native.evaluate(pose, gravity, after)
    np.testing.assert_array_equal(after, before)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("body_bones", 5),
        ("body_bones", -1),
        ("body_patch", 10**6),
        ("body_patch", -1),
        ("block_vertices", 50),
        ("block_vertices", -2),
        ("candidates", 20),
        ("candidates", -1),
        ("candidate_start", 10**6),
        ("candidate_start", -1),
        ("body_vertices", np.nan),
        ("body_normals", np.inf),
        ("body_weights", np.nan),
        ("body_bend", -np.inf),
    ],
)
def test_values_out_of_bounds_are_refused(name, value, in_contact):
    """An index that a frame would follow out of bounds, or a number that is not finite."""
    garment, push_out, _, _ = in_contact(np.random.default_rng(7))
    broken = getattr(push_out, name).copy()
    broken.reshape(-1)[-1] = value
    with pytest.raises(ValueError, match=name):
        NativeEvaluator(garment, push_out=replace(push_out, **{name: broken}))


def test_wrong_layouts_are_refused(in_contact):
    """Other dtypes, shapes or strides, and blocks that are empty or not in order."""
    garment, push_out, _, _ = in_contact(np.random.default_rng(8))
    changes = {
        "body_vertices": push_out.body_vertices.astype(np.float64),
        "body_weights": push_out.body_weights[:-1],
        "body_patch": push_out.body_patch[:, :-1],
        "block_vertices": push_out.block_vertices[:, ::-1],
        "candidates": push_out.candidates.astype(np.int64),
    }
    for name, array in changes.items():
        with pytest.raises(ValueError, match=name):
            NativeEvaluator(garment, push_out=replace(push_out, **{name: array}))
    backwards = push_out.candidate_start.copy()
    backwards[1] = backwards[-1] + 1
    with pytest.raises(ValueError, match="candidate_start"):
        NativeEvaluator(garment, push_out=replace(push_out, candidate_start=backwards))
    empty = push_out.block_vertices.copy()
    empty[0] = -1
    with pytest.raises(ValueError, match="no vertices"):
        NativeEvaluator(garment, push_out=replace(push_out, block_vertices=empty))
