"""What the push-out reaches, measured by exact distances."""

from __future__ import annotations

import numpy as np
import pytest
from random_models import needs_native

torch = pytest.importorskip("torch")
pytest.importorskip("warp")

from training.small_runs import waist_band_model  # noqa: E402

from physkin_core.avatar.body_model import load_body_model  # noqa: E402
from physkin_core.model.garment import vertex_normals  # noqa: E402
from physkin_core.motion.motion import load_motion  # noqa: E402
from physkin_training.evaluate import push_out_quality  # noqa: E402
from physkin_training.evaluate.push_out_quality import ExactContact, measure_push_out  # noqa: E402

BODY = load_body_model()


def test_depth_is_exact_and_meeting_parts_are_told_apart():
    """Points a centimetre under and over the belly; the same when a forearm lies across it and runs through."""
    surface = BODY.vertices(BODY.held_out_bodies[0]).astype(np.float64)
    normals = vertex_normals(surface, BODY.faces)
    belly = np.argsort(np.linalg.norm(surface - [0.15, 0.0, 0.12], axis=1))[:5]
    under, over = surface[belly] - 0.01 * normals[belly], surface[belly] + 0.01 * normals[belly]
    points = np.concatenate([under, over])
    exact = ExactContact(0, np.concatenate([surface[belly]] * 2))
    ((distance, meeting),) = exact(BODY.rig.rest[None].astype(np.float32), points[None])
    np.testing.assert_allclose(distance[0, :5], -0.01, atol=2e-3)
    np.testing.assert_allclose(distance[0, 5:], 0.01, atol=2e-3)
    assert not meeting.any()

    rng = np.random.default_rng(0)
    poses = rng.uniform(BODY.rig.lower, BODY.rig.upper, size=(48, len(BODY.rig.rest))).astype(np.float32)
    skin = surface[::40] - 0.003 * normals[::40]
    ((distance, meeting),) = ExactContact(0, skin)(BODY.rig.rest[None].astype(np.float32), skin[None])
    at_rest = meeting.mean()
    transforms = BODY.rig.bone_transforms  # of each pose, for points that follow the skin
    bones, weights = BODY.influence_bones[::40], BODY.influence_weights[::40]
    heads = (BODY.mean_bones + np.tensordot(BODY.held_out_bodies[0], BODY.bone_components, axes=1))[:, 0]
    moved = []
    for pose in poses:
        blend = np.einsum("vk,vkij->vij", weights, transforms(pose, heads=heads)[bones])
        moved.append(np.einsum("vij,vj->vi", blend[:, :, :3], skin) + blend[:, :, 3])
    _, posed_meeting = ExactContact(0, skin)(poses, np.stack(moved))[0]
    assert at_rest < 0.03 and posed_meeting.mean() > 1.5 * at_rest, "poses over all limits run limbs through each other"


@needs_native
def test_a_tight_band_is_pushed_out(monkeypatch):
    """Counts over every frame, fewer deep afterwards, none of it for nothing."""
    monkeypatch.setattr(push_out_quality, "bundled_motions", lambda: ["kick"])
    model = waist_band_model()
    quality = measure_push_out(model, bodies=1, poses=4)
    frames = load_motion("kick").frame_count + 4
    assert quality.before.vertices == quality.after.vertices == frames * len(model.garment.vertices)
    assert 0 < quality.after.deep < 0.9 * quality.before.deep
    assert quality.after.deepest <= quality.before.deepest and quality.largest_step > 0
    assert quality.jitter_ratio > 0 and quality.microseconds[1] <= quality.microseconds[0]
