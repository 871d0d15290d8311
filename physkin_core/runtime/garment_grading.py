"""Made to measure: a garment's rest shape graded to a body, as a tailor grades.

Every garment vertex is tied to the body near it on the garment maker's body. What the ties say is smoothed over the
garment, with less trust in them the looser the cloth hangs there: widely, so that seams stay straight and a shirt does
not take the shape of what it hides. Where the body would come through, cloth is then let out, and only there.
A child's garment is the adult's at its scale before it is graded: it is looser than the body in proportion.

Dimensions: `n` garment vertices, `V` body vertices, `c` shape coefficients. Metres, canonical pose.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from physkin_core.avatar.body_model import ADULT_STATURE, BodyModel
from physkin_core.model.garment import Garment, face_areas, vertex_normals

__all__ = ["GarmentGrading"]

TIES = 32
"""Body vertices that a garment vertex is tied to."""
TIE_RADIUS = 0.02
"""Ties weaken by e where the body is this much farther [m] than at its closest."""
CLOSE, WIDE = 0.02, 0.06
"""Lengths [m] over which ties are smoothed along the cloth: where it follows skin closely, and where it is graded."""
CLEAR = 0.006
"""[m] Cloth is let out until it is so far from the body, or as far as on the garment maker's where that is less."""
LETTING_OUT, GENEROUS = 4, 1.9
"""Times that cloth is let out, each time by so much of what it lacks, as smoothing takes some of that away."""
TOGETHER = 16
"""Bodies that a garment is graded to at a time."""
ONE_SIDED = 0.7
"""Length of the mean normal of the ties below which the body near a vertex has no one side, as between legs."""
LOOSE = 0.03
"""Distance [m] to the body at which a vertex's ties count a quarter of what they do on the body."""
FACING_AWAY = 0.02
"""What a tie to a part of the body that faces the other way counts, against one to a part that faces alike."""
CHILD_STATURE = 1.15
"""[m] From here down garments are at the scale of the body; from `ADULT_STATURE` up they are as they were made."""


class GarmentGrading:
    """Grades one garment, made on the garment maker's body of `body`. Takes tenths of a second to set up."""

    def __init__(self, garment: Garment, body: BodyModel) -> None:
        self.garment, self.body = garment, body
        self.template = body.vertices(body.garment_body).astype(np.float64)
        self._ties, distance = _ties(garment, self.template, body.faces)
        self._close, self._wide = _smoothings(garment, distance, CLOSE, WIDE)
        made = _along(garment.vertices - self._tied(self.template[None]), self._outwards(self.template[None]))
        self._needed = np.minimum(made, CLEAR)

    def carried(self, displacement: np.ndarray) -> np.ndarray:
        """Displacement of the garment (n, 3) [m] that follows one of the garment maker's body (V, 3) [m] closely, for
        skin that is elsewhere than that of the body model. Linear."""
        return self._close(self._ties @ displacement)

    def measured(self, surface: np.ndarray) -> np.ndarray:
        """Displacement of the garment (n, 3) or (k, n, 3) [m] that grades it to one or k bodies with vertices (V, 3) or
        (k, V, 3) [m]."""
        surfaces = surface.reshape(-1, *self.template.shape)
        scale = self._scales(surfaces)[:, None, None]
        moved = (scale - 1) * self.garment.vertices + self._wide(self._tied(surfaces - scale * self.template))
        places, outwards = self._tied(surfaces), self._outwards(surfaces)
        for _ in range(LETTING_OUT):
            lacking = self._needed - _along(self.garment.vertices + moved - places, outwards)
            moved = moved + self._close(GENEROUS * np.maximum(lacking, 0.0)[..., None] * outwards)
        return moved.reshape(*surface.shape[:-2], -1, 3)

    def _scales(self, surfaces: np.ndarray) -> np.ndarray:
        """(k,) of garments for bodies (k, V, 3): 1 for adults."""
        stature = np.ptp(surfaces[..., 2], axis=1)
        small = np.clip((ADULT_STATURE - stature) / (ADULT_STATURE - CHILD_STATURE), 0, 1)
        return 1 + small * (stature / np.ptp(self.template[:, 2]) - 1)

    def _tied(self, fields: np.ndarray) -> np.ndarray:
        """(k, n, 3) what garment vertices are tied to of fields over bodies (k, V, 3)."""
        columns = np.moveaxis(fields, 0, 1)
        tied = (self._ties @ columns.reshape(len(columns), -1)).reshape(-1, *columns.shape[1:])
        return np.moveaxis(tied, 1, 0)

    def _outwards(self, surfaces: np.ndarray) -> np.ndarray:
        """(k, n, 3) normals of what garment vertices are tied to, zero where that has no one side."""
        normals = self._tied(np.stack([vertex_normals(surface, self.body.faces) for surface in surfaces]))
        length = np.linalg.norm(normals, axis=-1, keepdims=True)
        return np.where(length < ONE_SIDED, 0.0, normals / np.maximum(length, ONE_SIDED))

    def closest_vertices(self, points: np.ndarray) -> np.ndarray:
        """(k,) the garment vertex closest to each of points (k, 3): garment nodes are graded as theirs is."""
        from scipy.spatial import cKDTree

        return cKDTree(self.garment.vertices).query(points)[1]

    def graded(self, coefficients: np.ndarray) -> np.ndarray:
        """Rest positions made to measure (s, n, 3) [m] for bodies of the body model. coefficients: (s, c). Many bodies
        take all cores."""
        parts = np.array_split(np.asarray(coefficients), range(TOGETHER, len(coefficients), TOGETHER))
        with ThreadPoolExecutor(min(len(parts), os.cpu_count() or 1)) as threads:
            moved = list(threads.map(self._measured, parts))
        return self.garment.vertices + np.concatenate(moved)

    def _measured(self, coefficients: np.ndarray) -> np.ndarray:
        return self.measured(np.stack([self.body.vertices(row).astype(np.float64) for row in coefficients]))


def _smoothings(garment: Garment, distance: np.ndarray, *lengths: float) -> list[Callable[[np.ndarray], np.ndarray]]:
    """One for each length [m] over which to smooth, with the less trust the farther, distance (n,) [m], the body is.
    Each takes and gives (..., n, 3)."""
    from scipy.sparse import diags_array
    from scipy.sparse.linalg import splu

    areas = np.maximum(garment.vertex_areas, 1e-10)  # of vertices that no face uses
    stiffness = _laplacian(garment)
    bending = stiffness @ diags_array(1 / areas) @ stiffness
    trust = areas / (1 + (distance / LOOSE) ** 2) ** 2
    symmetric = {"permc_spec": "MMD_AT_PLUS_A", "diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}}

    def smoothing(length: float) -> Callable[[np.ndarray], np.ndarray]:
        system = splu((diags_array(trust) + length**4 * bending).tocsc(), **symmetric)

        def smooth(fields: np.ndarray) -> np.ndarray:
            columns = np.moveaxis(fields, -2, 0)
            smooth = system.solve(trust[:, None] * columns.reshape(len(columns), -1))
            return np.moveaxis(smooth.reshape(columns.shape), 0, -2)

        return smooth

    return list(map(smoothing, lengths))


def _along(ways: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """(...,) of ways and directions (..., 3)."""
    return np.einsum("...i,...i->...", ways, directions)


def _ties(garment: Garment, body_vertices: np.ndarray, body_faces: np.ndarray):
    """Sparse (n, V) shares of body vertices, rows sum to 1, and distance (n,) [m] to the closest one."""
    from scipy.sparse import csr_array
    from scipy.spatial import cKDTree

    distance, near = cKDTree(body_vertices).query(garment.vertices, k=TIES)
    own = vertex_normals(garment.vertices, garment.faces)
    alike = np.einsum("nki,ni->nk", vertex_normals(body_vertices, body_faces)[near], own)
    areas = np.repeat(face_areas(body_vertices, body_faces) / 3, 3)
    areas = np.bincount(body_faces.reshape(-1), weights=areas, minlength=len(body_vertices))
    share = areas[near] * np.exp(-(((distance - distance[:, :1]) / TIE_RADIUS) ** 2))
    share *= FACING_AWAY + np.clip(alike, 0, 1)
    share /= share.sum(axis=1, keepdims=True)
    starts = np.arange(0, near.size + 1, TIES)
    return csr_array((share.reshape(-1), near.reshape(-1), starts), (len(near), len(body_vertices))), distance[:, 0]


def _laplacian(garment: Garment):
    """Sparse (n, n) stiffness of the cotangent Laplacian; weights that obtuse corners make negative are left at a
    little above zero."""
    from scipy.sparse import coo_array, diags_array

    x, n = garment.vertices, len(garment.vertices)
    weights = coo_array((n, n)).tocsr()
    for first, second, opposite in (garment.faces[:, order].T for order in ([0, 1, 2], [1, 2, 0], [2, 0, 1])):
        a, b = x[first] - x[opposite], x[second] - x[opposite]
        half = (a * b).sum(axis=1) / np.linalg.norm(np.cross(a, b), axis=1) / 2
        pairs = np.concatenate([first, second]), np.concatenate([second, first])
        weights = weights + coo_array((np.tile(half, 2), pairs), shape=(n, n)).tocsr()
    weights.data = np.maximum(weights.data, 0.05)
    return diags_array(np.asarray(weights.sum(axis=1)).reshape(-1)) - weights
