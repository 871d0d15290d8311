"""An avatar as its file has it, in its own pose, and how a garment that lies on it there comes into the canonical pose.

Between the two poses the trunk and each limb segment move as one (`physkin_core.rig.canonical_pose`).
Dimensions: `V` body vertices, `n` garment vertices, `s` moving parts (the trunk, then the limb segments). Root frame.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array, diags_array
from scipy.sparse.csgraph import laplacian
from scipy.sparse.linalg import splu
from scipy.spatial import cKDTree

from physkin_core.avatar.avatar import Avatar, AvatarError
from physkin_core.model.garment import vertex_normals
from physkin_core.model.surface_paths import mesh_edges
from physkin_core.rig.canonical_pose import LIMB_SEGMENTS
from physkin_core.rig.linear_blend_skinning import dense_weights
from physkin_core.rig.rig import Rig
from physkin_training.contact.surface_queries import BodySurface

__all__ = ["OwnPose"]

LARGEST_RESIDUAL = 0.003
"""[m] mean distance that the moving parts may leave between the avatar and its file."""
SMOOTHING = 0.03
"""Length [m] over which the cloth's share in moving parts is averaged."""
ABOVE, REACH = 0.01, 0.3
"""[m] from how far above the cloth to how far below it skin is looked for."""
UNKNOWN = 1e-6
"""How much the nearest skin counts where there is none behind the cloth."""


@dataclass(frozen=True)
class OwnPose:
    """vertices: (V, 3) [m], the avatar in the pose of its file, its trunk where it is in the canonical pose; faces:
    (f, 3). scale, turn (3, 3), shift (3,) [m]: from the file, x = scale * turn @ file + shift; scale in metres.
    transforms: (s, 3, 4) of the moving parts into the canonical pose. parts: (V, s), how much each moves a vertex.
    """

    vertices: np.ndarray
    faces: np.ndarray
    scale: float
    turn: np.ndarray
    shift: np.ndarray
    transforms: np.ndarray
    parts: np.ndarray

    @classmethod
    def of(cls, avatar: Avatar, in_file: np.ndarray, rig: Rig) -> OwnPose:
        """The pose in which the avatar's vertices are at `in_file` (V, 3), in the frame and unit of its file.

        Raises AvatarError where trunk and limb segments do not lead from there to the canonical pose.
        """
        bones = dense_weights(avatar.influence_bones, avatar.influence_weights, rig.bone_count)
        parts = bones @ np.eye(len(LIMB_SEGMENTS) + 1)[_moving_parts(rig)]
        points = np.column_stack([in_file, np.ones(len(in_file))])
        design = (parts[:, :, None] * points[:, None]).reshape(len(points), -1)
        solved = np.linalg.lstsq(design, avatar.vertices.astype(np.float64), rcond=None)[0]
        residual = np.linalg.norm(design @ solved - avatar.vertices, axis=1).mean()
        if residual > LARGEST_RESIDUAL:
            raise AvatarError(
                f"avatar {avatar.source}: its limbs' bones lead from its own pose to {1000 * residual:.1f} mm from the "
                f"canonical one, allowed are {1000 * LARGEST_RESIDUAL:g} mm; save it in the pose in which it was bound"
            )
        transforms = solved.reshape(-1, 4, 3).swapaxes(1, 2)
        trunk = np.vstack([transforms[0], [0.0, 0.0, 0.0, 1.0]])
        scale = float(np.cbrt(np.linalg.det(trunk[:3, :3])))
        return cls(
            vertices=points @ transforms[0].T,
            faces=avatar.faces,
            scale=scale,
            turn=trunk[:3, :3] / scale,
            shift=trunk[:3, 3],
            transforms=transforms @ np.linalg.inv(trunk),
            parts=parts,
        )

    def canonical(self, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
        """Garment vertices (n, 3) [m] that lie on the avatar in its own pose, in the canonical one.

        Cloth follows the skin behind it, not a hand that hangs beside it; where there is none near, the cloth around.
        faces: (f, 3), their outside away from the body.
        """
        surface = BodySurface(self.vertices, self.faces)
        outwards = vertex_normals(vertices, faces)
        face, barycentric = surface.facing(vertices + ABOVE * outwards, -outwards, ABOVE + REACH)
        behind = np.einsum("nk,nks->ns", barycentric, self.parts[self.faces[face]])
        known = np.where(face < 0, UNKNOWN, 1.0)
        nearest = self.parts[cKDTree(self.vertices).query(vertices)[1]]
        parts = _smooth(np.where(face[:, None] < 0, nearest, behind), known, vertices, faces)
        blended = np.einsum("ns,sij->nij", parts, self.transforms)
        return np.einsum("nij,nj->ni", blended[..., :3], vertices) + blended[..., 3]


def _smooth(weights: np.ndarray, known: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Weights (n, s) of vertices (n, 3), averaged over `SMOOTHING` along the cloth of faces (f, 3). known: (n,), how
    much each counts."""
    edges, _ = mesh_edges(faces)
    length = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1).mean()
    n, ends = len(vertices), np.concatenate([edges, edges[:, ::-1]])
    joined = coo_array((np.ones(len(ends)), ends.T), shape=(n, n)).tocsr()
    system = diags_array(known) + (SMOOTHING / length) ** 2 * laplacian(joined)
    return splu(system.tocsc()).solve(known[:, None] * weights)


def _moving_parts(rig: Rig) -> np.ndarray:
    """(b,) the part each bone moves with: 0 the trunk, then the segments of `LIMB_SEGMENTS`."""
    starts = {rig.bone_index(name): part for part, name in enumerate(LIMB_SEGMENTS, 1) if name in rig.bone_names}
    return rig.inherited(starts, 0)
