"""Linear blend skinning of a garment to its garment nodes, and normals (paper: Node-based Skinning for Garments)."""

import numpy as np


def rest_offsets(garment, offsets):
    """What offsets of detail nodes (D, 3) add to rest vertices (n, 3), of which each goes with a few of them."""
    return np.einsum("nj,nji->ni", garment.detail_weights.astype(np.float64), offsets[garment.detail_nodes])


def skin(garment, nodes, offsets=()):
    """Positions (n, 3), x' = sum_i w_i chi_i chi-bar_i^-1 x, and normals (n, 3), not yet of unit length: the cofactors
    of the blended linear part times those at rest.

    garment: node_rest (m, 3), vertices, normals (n, 3), influence_nodes, influence_weights (n, K). nodes: (m, 3, 4).
    offsets: (D, 3) of detail nodes, of a garment with detail, which move the rest vertices before.
    """
    linear, rest = nodes[:, :, :3], garment.node_rest.astype(np.float64)
    shift = nodes[:, :, 3:] - linear @ rest[..., None]
    weights, matrices = garment.influence_weights.astype(np.float64), np.concatenate([linear, shift], axis=2)
    blended = np.einsum("nk,nkij->nij", weights, matrices[garment.influence_nodes])
    vertices = garment.vertices.astype(np.float64) + (rest_offsets(garment, offsets) if len(offsets) else 0)
    positions = blended[:, :, :3] @ vertices[..., None] + blended[:, :, 3:]
    x, y, z = np.moveaxis(blended[:, :, :3], 2, 0)
    cofactors = np.stack([np.cross(y, z), np.cross(z, x), np.cross(x, y)], axis=2)
    return positions[..., 0], (cofactors @ garment.normals[..., None])[..., 0]


def unit(vectors):
    """Vectors (n, 3) at unit length; one without a length stays zero."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-30)


def face_normals(positions, faces):
    """Unit normals (n, 3) at vertices, those of the faces (f, 3) around each weighted by area; +Z without faces."""
    first, second, third = positions[faces.T]
    sums = np.zeros_like(positions)
    np.add.at(sums, faces, np.cross(second - first, third - first)[:, None])
    length = np.linalg.norm(sums, axis=1, keepdims=True)
    return np.where(length > 1e-20, sums / np.maximum(length, 1e-20), [0, 0, 1])
