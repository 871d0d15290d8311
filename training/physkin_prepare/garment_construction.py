"""Surface operations that turn a piece of a helper mesh into a garment: clip, offset, loft, remesh, fair.

Frame: the avatar's root frame, X forward, Y left, Z up, origin at the head of the root bone. Unit: metres.
Letters: `n` vertices, `f` triangles, `r` vertices of one boundary loop. Outward winding is counter-clockwise outside.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import gpytoolbox
import numpy as np
import scipy.sparse
import scipy.spatial
import trimesh

from physkin_training.fit_garment.mesh_repair import boundary_loops, compacted

__all__ = ["Shell", "clip", "fair", "largest_component", "loft", "offset", "remesh"]

REMESH_ITERATIONS = 20
FAIRING_ITERATIONS = 40
FAIRING_SHRINK = 0.5
FAIRING_GROW = -1.0 / (1.0 / FAIRING_SHRINK - 0.1)  # passes what varies more slowly than Taubin's k = 0.1
LOFT_SMOOTHING_WINDOW = 9


@dataclass(frozen=True)
class Shell:
    """An open triangle surface on its way to become a garment.

    vertices: (n, 3) float64 positions, root frame [m].
    faces: (f, 3) int vertex indices, outward winding.
    arm_skinning_weights: (n, 2) float64 in [0, 1], summed skinning weights of the left and of the right arm's bones.
    """

    vertices: np.ndarray
    faces: np.ndarray
    arm_skinning_weights: np.ndarray

    def compacted(self, faces: np.ndarray) -> Shell:
        """Return the shell made of `faces` (f', 3) alone, without the vertices that none of them uses."""
        vertices, renumbered = compacted(self.vertices, faces)
        return Shell(vertices, renumbered, self.arm_skinning_weights[np.unique(faces)])


def clip(shell: Shell, field: np.ndarray) -> Shell:
    """Keep the part of `shell` where the scalar `field` (n,), linear inside each triangle, is positive."""
    field = np.where(np.abs(field) < 1e-6, 1e-6, field)  # a cut through a vertex would leave a degenerate triangle
    inside = field[shell.faces] > 0
    inside_count = inside.sum(axis=1)
    cut = (inside_count == 1) | (inside_count == 2)
    odd_corner = np.where(inside_count == 1, inside.argmax(axis=1), inside.argmin(axis=1))[cut]
    odd, after, before = np.take_along_axis(shell.faces[cut], (odd_corner[:, None] + np.arange(3)) % 3, axis=1).T

    crossed = np.sort(np.concatenate([np.stack([odd, after], 1), np.stack([odd, before], 1)]), axis=1)
    edges, edge_of_crossing = np.unique(crossed, axis=0, return_inverse=True)
    cut_after, cut_before = (len(field) + edge_of_crossing.reshape(2, -1)).astype(shell.faces.dtype)
    start, end = edges.T
    share = (field[start] / (field[start] - field[end]))[:, None]

    def with_cuts(attribute: np.ndarray) -> np.ndarray:
        return np.concatenate([attribute, attribute[start] * (1 - share) + attribute[end] * share])

    lone = inside_count[cut] == 1
    faces = np.concatenate(
        [
            shell.faces[inside_count == 3],
            np.stack([odd, cut_after, cut_before], 1)[lone],
            np.stack([cut_after, after, before], 1)[~lone],
            np.stack([cut_after, before, cut_before], 1)[~lone],
        ]
    )
    whole = Shell(with_cuts(shell.vertices), shell.faces, with_cuts(shell.arm_skinning_weights))
    return whole.compacted(faces)


def largest_component(shell: Shell) -> Shell:
    """Keep the connected component of `shell` that has the most vertices."""
    component = gpytoolbox.connected_components(shell.faces)
    largest = np.bincount(component).argmax()
    return shell.compacted(shell.faces[component[shell.faces[:, 0]] == largest])


def offset(shell: Shell, distance: np.ndarray | float, *, smoothing_iterations: int = 6) -> Shell:
    """Move the vertices of `shell` by `distance`, a scalar or (n,) [m], along its smoothed outward normals."""
    normals = trimesh.Trimesh(shell.vertices, shell.faces, process=False).vertex_normals
    edges = gpytoolbox.edges(shell.faces)
    average = neighbour_average(np.concatenate([edges, edges[:, ::-1]]))
    for _ in range(smoothing_iterations):
        normals = 0.5 * normals + 0.5 * (average @ normals)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return replace(shell, vertices=shell.vertices + normals * np.broadcast_to(distance, len(normals))[:, None])


def neighbour_average(directed_edges: np.ndarray) -> scipy.sparse.csr_matrix:
    """Return the (n, n) operator that averages over the heads of the edges (e, 2) that leave a vertex."""
    tails, heads = directed_edges.T
    return scipy.sparse.csr_matrix((1.0 / np.bincount(tails)[tails], (tails, heads)))


def loft(
    shell: Shell, loop: np.ndarray, heights: np.ndarray, body_points: np.ndarray, *, ease: float, flare: float
) -> Shell:
    """Extrude the boundary loop `loop` (r,) of `shell` downwards, one ring of vertices at each of `heights` (k,) [m].

    Each ring keeps the directions of the loop about its centre. Its radius is the largest of the loop's own and that of
    the convex hull of the body above the ring plus `ease` [m], widened by `flare` [m] for every metre below the loop.

    body_points: (b, 3) vertices of the body without arms [m, root frame].
    """
    ring = shell.vertices[loop]
    top = ring[:, 2].mean()
    centre = ring[:, :2].mean(axis=0)
    loop_radius = np.linalg.norm(ring[:, :2] - centre, axis=1)
    directions = (ring[:, :2] - centre) / loop_radius[:, None]
    rings = []
    for height in heights:
        slab = body_points[(body_points[:, 2] < top) & (body_points[:, 2] > height - 0.01)]
        hull_radius = convex_hull_radius(slab[:, :2] - centre, directions) + ease
        radius = np.maximum(loop_radius, hull_radius) + flare * (top - height)
        radius = np.maximum(circular_mean(radius, LOFT_SMOOTHING_WINDOW), hull_radius)
        rings.append(np.column_stack([centre + directions * radius[:, None], np.full(len(loop), height)]))

    added = len(shell.vertices) + np.arange(len(heights) * len(loop)).reshape(len(heights), len(loop))
    indices = np.concatenate([loop[None], added])
    upper, lower = indices[:-1].ravel(), indices[1:].ravel()
    upper_next, lower_next = np.roll(indices[:-1], -1, axis=1).ravel(), np.roll(indices[1:], -1, axis=1).ravel()
    return Shell(
        np.concatenate([shell.vertices, *rings]),
        np.concatenate(
            [shell.faces, np.stack([upper_next, upper, lower], 1), np.stack([upper_next, lower, lower_next], 1)]
        ),
        np.concatenate([shell.arm_skinning_weights, np.zeros((len(heights) * len(loop), 2))]),
    )


def convex_hull_radius(points: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Return where rays from the origin along `directions` (r, 2) leave the convex hull of `points` (b, 2) [m]."""
    equations = scipy.spatial.ConvexHull(points).equations
    approach = directions @ equations[:, :2].T
    with np.errstate(divide="ignore"):
        return np.where(approach > 1e-9, -equations[:, 2] / approach, np.inf).min(axis=1)


def circular_mean(values: np.ndarray, window: int) -> np.ndarray:
    """Return the moving average of the cyclic sequence `values` (r,) over `window` entries, an odd number."""
    half = window // 2
    padded = np.concatenate([values[-half:], values, values[:half]])
    return np.convolve(padded, np.full(window, 1.0 / window), "valid")


def weld_short_boundary_edges(
    vertices: np.ndarray, faces: np.ndarray, shortest: float
) -> tuple[np.ndarray, np.ndarray]:
    """Contract boundary edges shorter than `shortest` [m] to their midpoints, since remeshing keeps them all."""
    vertices = vertices.copy()
    while True:
        target = np.arange(len(vertices))
        touched = np.zeros(len(vertices), bool)
        for loop in boundary_loops(faces):
            for start, end in zip(loop, np.roll(loop, -1), strict=True):
                if touched[[start, end]].any() or np.linalg.norm(vertices[start] - vertices[end]) >= shortest:
                    continue
                target[end] = start
                vertices[start] = 0.5 * (vertices[start] + vertices[end])
                touched[[start, end]] = True
        if not touched.any():
            return vertices, faces
        faces = target[faces]
        faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
        vertices, faces = compacted(vertices, faces)


def remesh(vertices: np.ndarray, faces: np.ndarray, edge_length: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the surface as even triangles (vertices (n, 3) [m], faces (f, 3)) of mean edge length `edge_length` [m].

    Botsch and Kobbelt, "A Remeshing Approach to Multiresolution Modeling", 2004. It moves no boundary vertex, so
    boundary edges are brought between 0.5 and 1.4 times the edge length beforehand.
    """
    vertices, faces = trimesh.remesh.subdivide_to_size(vertices, faces, max_edge=1.4 * edge_length, max_iter=12)
    vertices, faces = weld_short_boundary_edges(vertices, faces, 0.5 * edge_length)
    return gpytoolbox.remesh_botsch(
        np.ascontiguousarray(vertices),
        np.ascontiguousarray(faces, np.int32),
        REMESH_ITERATIONS,
        edge_length,
        project=True,
    )


def fair(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Return `vertices` (n, 3) [m] without the ridges that clip and loft left, which would stay in the rest shape.

    Taubin, "A Signal Processing Approach to Fair Surface Design", 1995: the second, negative step keeps the volume.
    Boundary vertices move along their own loop only, so that hems stay hems.
    """
    edges, boundary = gpytoolbox.edges(faces, return_boundary_indices=True)
    on_boundary = np.zeros(len(vertices), bool)
    on_boundary[edges[boundary]] = True
    inner = np.delete(edges, boundary, axis=0)
    directed = np.concatenate([inner, inner[:, ::-1]])
    directed = directed[~on_boundary[directed[:, 0]]]
    average = neighbour_average(np.concatenate([directed, edges[boundary], edges[boundary][:, ::-1]]))
    for _ in range(FAIRING_ITERATIONS):
        for step in (FAIRING_SHRINK, FAIRING_GROW):
            vertices = vertices + step * (average @ vertices - vertices)
    return vertices
