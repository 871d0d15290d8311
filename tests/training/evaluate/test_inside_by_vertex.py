"""Inside by the nearest body vertex: the Warp kernel against the k-d tree of `physkin_core.quality`."""

from __future__ import annotations

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="needs the [training] extra")
wp = pytest.importorskip("warp", reason="needs the [training] extra")

from physkin_core import avatar_from_body, load_body_model  # noqa: E402
from physkin_core.quality import inside_by_vertex as reference  # noqa: E402
from physkin_training.evaluate.inside_by_vertex import inside_by_vertex  # noqa: E402
from physkin_training.sampling.posed_bodies import BodySet, PosedBodies  # noqa: E402

BODY = load_body_model()


def test_kernel_agrees_with_the_tree():
    """Two bodies in random poses, each beside the other on the grid; points near the skin, and out of reach."""
    wp.config.quiet = True
    rng = np.random.default_rng(0)
    posed = PosedBodies(BODY, BodySet(BODY, BODY.held_out_bodies[:2], torch.device("cpu")), 2)
    q = rng.uniform(BODY.rig.lower, BODY.rig.upper, size=(2, len(BODY.rig.lower)))
    posed.pose(torch.as_tensor(q, dtype=torch.float32), torch.tensor([1, 0]))
    points, expected = [], []
    for index, positions in zip((1, 0), q):
        avatar = avatar_from_body(BODY, BODY.held_out_bodies[index])
        body = avatar.posed_vertices(BODY.rig.bone_transforms(positions, heads=avatar.bone_heads))
        near = body[rng.choice(len(body), 2000)] + 0.02 * rng.normal(size=(2000, 3))
        points.append(np.concatenate([near, [[0.0, 0.0, 1.6]]]))
        expected.append(reference(points[-1], body, BODY.faces))
    expected = np.array(expected)
    inside = inside_by_vertex(torch.as_tensor(np.array(points), dtype=torch.float32), posed, reach=0.3).numpy()
    assert 0.2 < expected.mean() < 0.8
    assert (inside != expected).mean() < 1e-3, "rounding may choose the other of two vertices all but equally near"
    assert not inside[:, -1].any()
