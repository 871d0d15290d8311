"""Surface points: even by area, the same for a seed, blind to how the surface is cut into triangles."""

import numpy as np
import pytest

from physkin_core.model.surface_sampling import sample_surface

SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=np.float64)
TWO_FACES = np.array([[0, 1, 2], [0, 2, 3]])


def _uneven_square(cuts=24):
    """The unit square as a grid whose cells shrink towards one corner, faces shuffled."""
    at = np.linspace(0, 1, cuts + 1) ** 3
    x, y = np.meshgrid(at, at, indexing="ij")
    corner = np.arange((cuts + 1) ** 2).reshape(cuts + 1, -1)
    a, b, c, d = corner[:-1, :-1].ravel(), corner[1:, :-1].ravel(), corner[1:, 1:].ravel(), corner[:-1, 1:].ravel()
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    return np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1), np.random.default_rng(1).permutation(faces)


def _cell_counts(points, cells=8):
    index = np.minimum((points[:, :2] * cells).astype(int), cells - 1)
    return np.bincount(index[:, 0] * cells + index[:, 1], minlength=cells * cells)


@pytest.mark.parametrize("mesh", [(SQUARE, TWO_FACES), _uneven_square()], ids=["two faces", "1152 uneven faces"])
def test_density_follows_area_not_triangles(mesh):
    """64 cells of equal area get 64 of 4096 points each; independent draws would scatter by 8."""
    points, normals = sample_surface(*mesh, 4096)
    assert points.shape == normals.shape == (4096, 3) and points.dtype == normals.dtype == np.float32
    assert np.abs(points[:, 2]).max() == 0 and np.allclose(normals, [0, 0, 1])
    counts = _cell_counts(points)
    assert counts.std() < 4 and np.abs(counts - 64).max() < 16


def test_same_seed_same_points():
    """Whatever the order of the faces; another seed moves the points."""
    vertices, faces = _uneven_square()
    shuffled = np.random.default_rng(2).permutation(faces)
    first, again, other = (
        sample_surface(vertices, f, 500, seed=s)[0] for f, s in ((faces, 0), (shuffled, 0), (faces, 1))
    )
    assert np.allclose(first, again, atol=1e-6) and not np.allclose(first, other, atol=1e-2)


def test_degenerate_faces_get_no_points():
    """Faces without area are passed over, and normals stay finite."""
    faces = np.concatenate([[[0, 0, 1], [2, 2, 2]], TWO_FACES, [[1, 1, 1]]])
    points, normals = sample_surface(SQUARE, faces, 256)
    assert np.isfinite(points).all() and np.allclose(normals, [0, 0, 1])


@pytest.mark.parametrize(
    ("vertices", "faces", "count", "message"),
    [
        (SQUARE, TWO_FACES, 0, "at least 1, got 0"),
        (SQUARE, TWO_FACES + 1, 8, "span 1 to 4, allowed 0 to 3"),  # as `Garment` checks it
        (SQUARE * 0, TWO_FACES, 8, "none of the 2 faces has an area"),
    ],
)
def test_bad_surfaces_are_refused(vertices, faces, count, message):
    """Each error names the value and what was allowed."""
    with pytest.raises(ValueError, match=message):
        sample_surface(vertices, faces, count)
