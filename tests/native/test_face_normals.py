"""Normals from the faces of the posed mesh, against the reference, on every instruction set of this CPU."""

from dataclasses import replace

import numpy as np
import pytest
from native_frames import NativeFrame, clouds, told
from random_models import random_avatar, random_model, random_pose, tube
from reference.frame import ReferenceFrame
from scipy.spatial import Delaunay

from physkin_core import Draper
from physkin_core.model.garment import vertex_normals
from physkin_core.outfit.layer_order import bind_layer_order
from physkin_core.runtime import body_encoder
from physkin_core.runtime.evaluator import Skinner, supported_instruction_sets

LEVELS = supported_instruction_sets()


@pytest.fixture
def with_faces(make_garment, make_pose):
    """A garment of random faces, vertices in any number of them, the last one in none, and a pose."""

    def make(rng, vertices):
        faces = rng.integers(0, vertices - 1, size=(2 * vertices, 3)).astype(np.int32)
        garment = replace(make_garment(rng, vertices=vertices), faces=faces)
        return garment, *make_pose(rng, garment)

    return make


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("vertices", [5, 15, 16, 17, 101])
def test_agree_with_the_reference(vertices, level, with_faces):
    """In rows at any distance and any byte; positions are as they were."""
    rng = np.random.default_rng(vertices)
    garment, pose, gravity = with_faces(rng, vertices)
    row = told(gravity)
    (expected,) = clouds(ReferenceFrame([garment]), [garment], pose, row)
    bare = replace(garment, faces=garment.faces[:0])
    (skinned,) = clouds(NativeFrame([bare], instruction_set=level), [bare], pose, row)
    frame = NativeFrame([garment], instruction_set=level)
    message = bytearray(b"\7" * (vertices * 36 + 3))
    out = np.frombuffer(message, dtype=np.float32, offset=3).reshape(vertices, 9)
    before = out[:, 6:].copy()
    frame.evaluate(pose, row[None], [out[:, :6]])
    assert np.array_equal(out[:, :3], skinned[:, :3]) and np.array_equal(out[:, 6:], before)
    sums = np.zeros((vertices, 3))
    corners = expected[:, :3].astype(np.float64)[garment.faces]
    np.add.at(sums, garment.faces, np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, None])
    clear = np.linalg.norm(sums, axis=1) > 0.1  # elsewhere large faces cancel out
    assert clear.sum() >= vertices // 4
    assert np.abs(out[clear, 3:6] - expected[clear, 3:]).max() < 1e-4
    unused = np.setdiff1d(np.arange(vertices), garment.faces)
    assert np.abs(out[unused, 3:6] - [0, 0, 1]).max() < 1e-6 and len(unused) > 0
    positions = np.empty((vertices, 3), dtype=np.float32)
    frame.evaluate(pose, row[None], [positions])
    assert np.array_equal(positions, skinned[:, :3])


def sheets(rng, points):
    """Faces (f, 3) int32 of a random triangulation with a hole and of a fan that meets it in one vertex, in any order,
    each from any of its corners."""
    faces = Delaunay(rng.uniform(size=(points - 3, 2))).simplices
    faces = np.concatenate(
        [np.delete(faces, slice(20, 24), axis=0), [[0, points - 3, points - 2], [0, points - 2, points - 1]]]
    )
    turned = (np.arange(3) + rng.integers(0, 3, size=(len(faces), 1))) % 3
    return rng.permutation(np.take_along_axis(faces, turned, axis=1)).astype(np.int32)


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("points", [33, 192, 401])
def test_faces_go_round_a_vertex_in_any_number(points, level, make_garment, make_pose):
    """Three to ten, all around or not: as summed face by face."""
    rng = np.random.default_rng(points)
    garment = replace(make_garment(rng, vertices=points), faces=sheets(rng, points))
    around = np.bincount(garment.faces.ravel())
    assert around.min() <= 3 and around.max() >= 8 and len(set(around)) > 5
    pose, gravity = make_pose(rng, garment)
    (out,) = clouds(NativeFrame([garment], instruction_set=level), [garment], pose, told(gravity))
    a, b, c = out[garment.faces.T, :3].astype(np.float64)
    sums, areas = np.zeros((points, 3)), np.zeros(points)
    np.add.at(sums, garment.faces, np.cross(b - a, c - a)[:, None])
    np.add.at(areas, garment.faces, np.linalg.norm(np.cross(b - a, c - a), axis=1)[:, None])
    used, length = areas > 0, np.linalg.norm(sums, axis=1)  # maybe not all
    away = np.abs(out[used, 3:] - sums[used] / length[used, None]).max(axis=1)
    assert (away * length[used] / areas[used]).max() < 2e-6 and used.sum() >= points - 2


@pytest.mark.parametrize("vertices", [32768, 32769])
def test_of_as_many_vertices_as_16_bits_tell_apart_and_of_more(vertices, make_garment):
    rng = np.random.default_rng(43)
    sheet = tube(rings=160, segments=205, radius=0.2)
    faces = sheet.faces[(sheet.faces < vertices).all(axis=1)].astype(np.int32)
    garment = make_garment(rng, nodes=1, influences=1, vertices=vertices)
    garment = replace(garment, vertices=sheet.vertices[:vertices].astype(np.float32), faces=faces)
    still = np.concatenate([np.eye(3, dtype=np.float32)[None], garment.node_rest[:, :, None]], axis=2)
    out = np.empty((vertices, 6), dtype=np.float32)
    Skinner(garment).skin(still, out)
    assert np.abs(out[:, 3:] - vertex_normals(out[:, :3].astype(np.float64), faces)).max() < 2e-3


@pytest.mark.parametrize("level", LEVELS)
def test_detail_turns_them(level, make_garment, make_pose, monkeypatch):
    """Rest normals, which are carried along without faces, know nothing of folds. Positions are the same; so is what is
    skinned by garment nodes and detail nodes."""
    monkeypatch.setenv("PHYSKIN_NATIVE_ISA", level)
    rng = np.random.default_rng(41)
    plain = make_garment(rng, vertices=90, detail_nodes=12)
    garment = replace(plain, faces=sheets(rng, 90))
    pose, gravity = make_pose(rng, garment)
    frame, row = NativeFrame([garment]), told(gravity)
    (shown,) = clouds(frame, [garment], pose, row)
    (carried,) = clouds(NativeFrame([plain]), [plain], pose, row)
    assert np.array_equal(shown[:, :3], carried[:, :3])
    assert np.median(np.abs(shown[:, 3:] - carried[:, 3:]).max(axis=1)) > 0.1
    (expected,) = clouds(ReferenceFrame([garment]), [garment], pose, row)
    assert np.median(np.abs(shown - expected).max(axis=1)) < 1e-5
    skinned = np.empty_like(shown)
    Skinner(garment).skin(frame.node_transforms(), skinned, frame.detail_offsets())
    assert np.array_equal(skinned, shown)


def test_layers_are_ordered_by_normals_carried_along(make_garment, make_pose):
    """So their positions do not depend on how normals are shown; normals are of the faces where these have come to."""
    rng = np.random.default_rng(42)
    inner = tube(rings=15, segments=40, radius=0.15)
    dent = np.exp(-((np.linalg.norm(inner.vertices - inner.vertices[300], axis=1) / 0.05) ** 2))
    wide = inner.vertices * [1.04, 1.04, 1]
    outside, within = (cloth_of(each, inner.faces) for each in (wide, wide * (1 - 0.2 * dent[:, None] * [1, 1, 0])))
    inside = cloth_of(inner.vertices, inner.faces)
    order = bind_layer_order(0, 1, (inside[:, :3], outside[:, :3]), (inner.faces,) * 2, [(inside, outside)])
    garment = make_garment(rng, nodes=1, influences=1, vertices=len(dent), detail_nodes=12)
    garment = replace(garment, detail_offsets=0.02 * garment.detail_offsets)
    worn = [replace(garment, vertices=each[:, :3].copy(), normals=each[:, 3:].copy()) for each in (inside, within)]
    with_faces = [replace(each, faces=inner.faces.astype(np.int32)) for each in worn]
    pose, gravity = make_pose(rng, garment)
    shown, carried = (clouds(NativeFrame(each, [order]), each, pose, told(gravity)) for each in (with_faces, worn))
    (unmoved,) = clouds(NativeFrame(with_faces[1:]), with_faces[1:], pose, told(gravity))
    assert np.abs(unmoved - shown[1])[:, :3].max() > 0.005
    for cloud, other in zip(shown, carried):
        assert np.array_equal(cloud[:, :3], other[:, :3])
        assert np.abs(cloud[:, 3:] - vertex_normals(cloud[:, :3].astype(np.float64), inner.faces)).max() < 1e-4


def cloth_of(vertices, faces):
    return np.concatenate([vertices, vertex_normals(vertices, faces)], axis=1).astype(np.float32)


def test_points_carry_theirs_along(monkeypatch):
    """A garment's mesh has normals of its faces; its vertices, draped as points, have the model's rest normals."""
    monkeypatch.setattr(body_encoder, "POINT_COUNT", 50)
    rng = np.random.default_rng(71)
    model = random_model(rng)
    avatar, pose = random_avatar(rng, model.rig), random_pose(rng, model.rig)
    draped = Draper(model, avatar).drape(*pose)
    expected = vertex_normals(draped[:, :3].astype(np.float64), model.garment.faces)
    assert np.abs(draped[:, 3:] - expected).max() < 1e-4
    points = Draper(model, avatar, points=model.garment.vertices).drape(*pose)
    assert np.abs(points[:, :3] - draped[:, :3]).max() < 1e-5 and np.abs(points[:, 3:] - expected).max() > 0.01
