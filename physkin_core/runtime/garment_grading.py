"""Made to measure: a garment's rest shape graded to a body, linear in how that body's surface differs.

Every garment vertex is tied to the body near it on the garment maker's body. What the ties say is smoothed over the
garment, with less trust in them the looser the cloth hangs there, so that a skirt's hem follows hips and legs without
tearing. The distance to the body stays about what it is on the garment maker's.

Dimensions: `n` garment vertices, `V` body vertices, `c` shape coefficients. Metres, canonical pose.
"""

from __future__ import annotations

import numpy as np

from physkin_core.avatar.body_model import BodyModel
from physkin_core.model.garment import Garment, face_areas, vertex_normals

__all__ = ["GarmentGrading"]

TIES = 32
"""Body vertices that a garment vertex is tied to."""
TIE_RADIUS = 0.02
"""Ties weaken by e where the body is this much farther [m] than at its closest."""
SMOOTHING = 0.02
"""Length [m] over which ties are smoothed along the cloth."""
LOOSE = 0.03
"""Distance [m] to the body at which a vertex's ties count a quarter of what they do on the body."""
FACING_AWAY = 0.02
"""What a tie to a part of the body that faces the other way counts, against one to a part that faces alike."""


class GarmentGrading:
    """Grades one garment, made on the garment maker's body of `body`. Takes tenths of a second to set up."""

    def __init__(self, garment: Garment, body: BodyModel) -> None:
        from scipy.sparse import diags_array
        from scipy.sparse.csgraph import reverse_cuthill_mckee
        from scipy.sparse.linalg import splu

        self.garment, self.body = garment, body
        self.template = body.vertices(body.garment_body).astype(np.float64)
        self._ties, distance = _ties(garment, self.template, body.faces)
        areas = np.maximum(garment.vertex_areas, 1e-10)  # of vertices that no face uses
        stiffness = _laplacian(garment)
        bending = stiffness @ diags_array(1 / areas) @ stiffness
        self._trust = areas / (1 + (distance / LOOSE) ** 2) ** 2
        system = (diags_array(self._trust) + SMOOTHING**4 * bending).tocsc()
        # ordered here: SuperLU's own orderings hold the interpreter's lock for tens of milliseconds, while clouds wait
        self._order = reverse_cuthill_mckee(system, symmetric_mode=True)
        symmetric = {"diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}}
        self._system = splu(system[self._order][:, self._order].tocsc(), permc_spec="NATURAL", **symmetric)

    def carried(self, displacement: np.ndarray) -> np.ndarray:
        """Displacement of the garment (n, 3) or (k, n, 3) [m] for one or k displacements of the garment maker's body
        (V, 3) or (k, V, 3) [m]. Linear."""
        fields = np.moveaxis(displacement.reshape(-1, len(self.template), 3), 0, 1)
        tied = self._trust[:, None] * (self._ties @ fields.reshape(len(fields), -1))
        smooth = np.empty_like(tied)
        smooth[self._order] = self._system.solve(tied[self._order])
        smooth = smooth.reshape(len(tied), *fields.shape[1:])
        return np.moveaxis(smooth, 0, 1).reshape(*displacement.shape[:-2], -1, 3)

    def closest_vertices(self, points: np.ndarray) -> np.ndarray:
        """(k,) the garment vertex closest to each of points (k, 3): garment nodes are graded as theirs is."""
        from scipy.spatial import cKDTree

        return cKDTree(self.garment.vertices).query(points)[1]

    def components(self) -> np.ndarray:
        """Displacement of the garment (c, n, 3) [m] by each shape coefficient of the body model."""
        return self.carried(self.body.vertex_components.astype(np.float64))

    def graded(self, coefficients: np.ndarray) -> np.ndarray:
        """Rest positions made to measure (s, n, 3) [m] for bodies of the body model. coefficients: (s, c)."""
        difference = np.asarray(coefficients, dtype=np.float64) - self.body.garment_body
        return self.garment.vertices + np.tensordot(difference, self.components(), axes=1)


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
