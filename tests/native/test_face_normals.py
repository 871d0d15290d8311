"""Normals from the faces of the posed mesh, against the reference, on every instruction set of this CPU."""

from dataclasses import replace

import numpy as np
import pytest
from native_frames import NativeFrame, clouds, told
from random_models import random_avatar, random_model, random_pose
from reference.frame import ReferenceFrame

from physkin_core import Draper
from physkin_core.model.garment import vertex_normals
from physkin_core.runtime import body_encoder
from physkin_core.runtime.evaluator import supported_instruction_sets

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
    (expected,) = clouds(ReferenceFrame([garment], normals="faces"), [garment], pose, row)
    (skinned,) = clouds(NativeFrame([garment], instruction_set=level), [garment], pose, row)
    frame = NativeFrame([garment], instruction_set=level, normals="faces")
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
    assert (out[unused, 3:6] == [0, 0, 1]).all() and len(unused) > 0
    positions = np.empty((vertices, 3), dtype=np.float32)
    frame.evaluate(pose, row[None], [positions])
    assert np.array_equal(positions, skinned[:, :3])


def test_draper_takes_them_from_the_mesh_it_draped(monkeypatch):
    monkeypatch.setattr(body_encoder, "POINT_COUNT", 50)
    rng = np.random.default_rng(71)
    model = random_model(rng)
    avatar, pose = random_avatar(rng, model.rig), random_pose(rng, model.rig)
    draped = Draper(model, avatar, normals="faces").drape(*pose)
    expected = vertex_normals(draped[:, :3].astype(np.float64), model.garment.faces)
    assert np.abs(draped[:, 3:] - expected).max() < 1e-4
    assert np.abs(Draper(model, avatar).drape(*pose)[:, 3:] - expected).max() > 0.01
    for options, message in (
        (dict(normals="smooth"), "may be skinned or faces"),
        (dict(normals="faces", points=model.garment.vertices[:9]), "need a garment with faces"),
    ):
        with pytest.raises(ValueError, match=message):
            Draper(model, avatar, **options)
