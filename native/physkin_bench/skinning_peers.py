"""Libraries that skin the same garment on one thread: Warp, numba, scipy, torch, NumPy.

Dimensions: `n` vertices, `m` garment nodes, `K` influences.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from physkin_bench.peers import Peer, Runner, hold_blas_to_one_thread
from physkin_core.model.skinning import cofactors, skin, skinning_matrices
from physkin_core.runtime.bound_garment import BoundGarment

__all__ = ["SKINNING_PEERS", "SkinningCase", "skinning_case"]

EXACT = 1e-4


@dataclass(frozen=True)
class SkinningCase:
    """Input and right answer of a skinning peer.

    matrices: (m, 3, 4) float32, from rest to posed garment. vertices, normals: (n, 3) float32.
    nodes: (n, K) int32; weights: (n, K) float32. expected: (n, 6) float64, positions and unit normals.
    """

    matrices: np.ndarray
    vertices: np.ndarray
    normals: np.ndarray
    nodes: np.ndarray
    weights: np.ndarray
    expected: np.ndarray


def skinning_case(bound: BoundGarment, node_transforms: np.ndarray) -> SkinningCase:
    """The skinning of a bound garment by given garment nodes (m, 3, 4)."""
    transforms = node_transforms.astype(np.float64)
    positions, normals = skin(
        transforms, bound.node_rest, bound.vertices, bound.normals, bound.influence_nodes, bound.influence_weights
    )
    return SkinningCase(
        matrices=skinning_matrices(transforms, bound.node_rest).astype(np.float32),
        vertices=bound.vertices,
        normals=bound.normals,
        nodes=bound.influence_nodes,
        weights=bound.influence_weights,
        expected=np.concatenate([positions, normals], axis=1),
    )


def _homogeneous(case: SkinningCase) -> np.ndarray:
    return np.concatenate([case.vertices, np.ones((len(case.vertices), 1), dtype=np.float32)], axis=1)


def _numpy_apply(blended: np.ndarray, points: np.ndarray, normals: np.ndarray, out: np.ndarray) -> None:
    np.einsum("nij,nj->ni", blended, points, out=out[:, :3])
    turned = np.einsum("nij,nj->ni", cofactors(blended[:, :, :3]), normals)
    np.divide(turned, np.sqrt(np.einsum("ni,ni->n", turned, turned))[:, None], out=out[:, 3:])


def _numpy(case: SkinningCase) -> Runner:
    hold_blas_to_one_thread()
    points, out = _homogeneous(case), np.empty(case.expected.shape, dtype=np.float32)
    weights = case.weights[:, None, :]

    def run():
        blended = weights @ case.matrices.reshape(-1, 12)[case.nodes]
        _numpy_apply(blended.reshape(-1, 3, 4), points, case.normals, out)

    return Runner(run, lambda: out)


def _scipy(case: SkinningCase) -> Runner:
    from scipy.sparse import csr_array

    hold_blas_to_one_thread()
    points, out = _homogeneous(case), np.empty(case.expected.shape, dtype=np.float32)
    rows = np.repeat(np.arange(len(points)), case.nodes.shape[1])
    shape = (len(points), len(case.matrices))
    skinning_weights = csr_array((case.weights.ravel(), (rows, case.nodes.ravel())), shape=shape, dtype=np.float32)
    matrices = case.matrices.reshape(-1, 12)

    def run():
        _numpy_apply((skinning_weights @ matrices).reshape(-1, 3, 4), points, case.normals, out)

    return Runner(run, lambda: out)


def _torch(case: SkinningCase) -> Runner:
    import torch

    torch.set_num_threads(1)
    tensors = [torch.from_numpy(a) for a in (case.matrices.reshape(-1, 12), case.weights, _homogeneous(case))]
    matrices, weights, points = tensors
    normals, nodes = torch.from_numpy(case.normals), torch.from_numpy(case.nodes.astype(np.int64))
    out = torch.empty(case.expected.shape, dtype=torch.float32)

    def run():
        with torch.inference_mode():
            gathered = matrices.index_select(0, nodes.view(-1)).view(*nodes.shape, 12)
            blended = torch.bmm(weights[:, None], gathered).view(-1, 3, 4)
            out[:, :3] = torch.bmm(blended, points[..., None])[..., 0]
            x, y, z = blended[..., 0], blended[..., 1], blended[..., 2]
            sides = torch.linalg.cross(y, z), torch.linalg.cross(z, x), torch.linalg.cross(x, y)
            turned = torch.bmm(torch.stack(sides, dim=-1), normals[..., None])[..., 0]
            out[:, 3:] = torch.nn.functional.normalize(turned, dim=1)

    return Runner(run, lambda: out.numpy())


@cache
def _numba_kernel():
    import numba

    zero, one = np.float32(0), np.float32(1)

    @numba.njit(fastmath=True, boundscheck=False)
    def kernel(matrices, nodes, weights, vertices, normals, out):
        for v in range(vertices.shape[0]):
            # The three rows of the blended matrix, as scalars: small arrays would be allocated vertex by vertex.
            a0 = a1 = a2 = a3 = b0 = b1 = b2 = b3 = c0 = c1 = c2 = c3 = zero
            for k in range(nodes.shape[1]):
                w, m = weights[v, k], matrices[nodes[v, k]]
                a0, a1, a2, a3 = a0 + w * m[0], a1 + w * m[1], a2 + w * m[2], a3 + w * m[3]
                b0, b1, b2, b3 = b0 + w * m[4], b1 + w * m[5], b2 + w * m[6], b3 + w * m[7]
                c0, c1, c2, c3 = c0 + w * m[8], c1 + w * m[9], c2 + w * m[10], c3 + w * m[11]
            x, y, z = vertices[v, 0], vertices[v, 1], vertices[v, 2]
            out[v, 0] = a0 * x + a1 * y + a2 * z + a3
            out[v, 1] = b0 * x + b1 * y + b2 * z + b3
            out[v, 2] = c0 * x + c1 * y + c2 * z + c3
            x, y, z = normals[v, 0], normals[v, 1], normals[v, 2]
            p = (b1 * c2 - b2 * c1) * x + (b2 * c0 - b0 * c2) * y + (b0 * c1 - b1 * c0) * z
            q = (c1 * a2 - c2 * a1) * x + (c2 * a0 - c0 * a2) * y + (c0 * a1 - c1 * a0) * z
            r = (a1 * b2 - a2 * b1) * x + (a2 * b0 - a0 * b2) * y + (a0 * b1 - a1 * b0) * z
            inverse = one / np.sqrt(p * p + q * q + r * r)
            out[v, 3], out[v, 4], out[v, 5] = p * inverse, q * inverse, r * inverse

    return kernel


def _numba(case: SkinningCase) -> Runner:
    kernel = _numba_kernel()
    out = np.empty(case.expected.shape, dtype=np.float32)
    arguments = (case.matrices.reshape(-1, 12), case.nodes, case.weights, case.vertices, case.normals, out)
    return Runner(lambda: kernel(*arguments), lambda: out)


@cache
def _warp_kernel():
    import warp as wp

    def skin_vertex(
        matrices: wp.array2d(dtype=wp.vec4),
        nodes: wp.array2d(dtype=wp.int32),
        weights: wp.array2d(dtype=wp.float32),
        vertices: wp.array(dtype=wp.vec3),
        normals: wp.array(dtype=wp.vec3),
        out: wp.array2d(dtype=wp.vec3),
    ):
        v = wp.tid()
        a, b, c = wp.vec4(), wp.vec4(), wp.vec4()
        for k in range(nodes.shape[1]):
            node, weight = nodes[v, k], weights[v, k]
            a += weight * matrices[node, 0]
            b += weight * matrices[node, 1]
            c += weight * matrices[node, 2]
        x, n = vertices[v], normals[v]
        point = wp.vec4(x[0], x[1], x[2], 1.0)
        first, second, third = wp.vec3(a[0], a[1], a[2]), wp.vec3(b[0], b[1], b[2]), wp.vec3(c[0], c[1], c[2])
        out[v, 0] = wp.vec3(wp.dot(a, point), wp.dot(b, point), wp.dot(c, point))
        turned = wp.vec3(
            wp.dot(wp.cross(second, third), n), wp.dot(wp.cross(third, first), n), wp.dot(wp.cross(first, second), n)
        )
        out[v, 1] = wp.normalize(turned)

    # Annotations are strings in this file, and Warp reads types.
    kinds = (wp.array2d(dtype=wp.vec4), wp.array2d(dtype=wp.int32), wp.array2d(dtype=wp.float32))
    kinds += (wp.array(dtype=wp.vec3), wp.array(dtype=wp.vec3), wp.array2d(dtype=wp.vec3))
    skin_vertex.__annotations__ = dict(zip(("matrices", "nodes", "weights", "vertices", "normals", "out"), kinds))
    return wp.kernel(skin_vertex)


def _warp(case: SkinningCase) -> Runner:
    import warp as wp

    wp.config.log_level = wp.LOG_ERROR
    wp.init()
    kernel = _warp_kernel()
    n = len(case.vertices)
    out = wp.empty((n, 2), dtype=wp.vec3, device="cpu")
    inputs = [
        wp.array(case.matrices, dtype=wp.vec4, device="cpu"),
        wp.array(case.nodes, dtype=wp.int32, device="cpu"),
        wp.array(case.weights, dtype=wp.float32, device="cpu"),
        wp.array(case.vertices, dtype=wp.vec3, device="cpu"),
        wp.array(case.normals, dtype=wp.vec3, device="cpu"),
    ]
    command = wp.launch(kernel, dim=n, inputs=inputs, outputs=[out], device="cpu", record_cmd=True)
    return Runner(command.launch, lambda: out.numpy())


SKINNING_PEERS = (
    Peer("warp", ("warp-lang",), _warp, EXACT),
    Peer("numba", ("numba",), _numba, EXACT),
    Peer("torch", ("torch",), _torch, EXACT),
    Peer("scipy", ("scipy", "threadpoolctl"), _scipy, EXACT),
    Peer("numpy", ("numpy", "threadpoolctl"), _numpy, EXACT),
)
