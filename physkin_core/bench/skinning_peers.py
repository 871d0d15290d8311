"""Libraries that skin the same garment on one thread: Warp, numba, scipy, torch, NumPy.

Dimensions: `n` vertices, `m` garment nodes, `K` influences.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from physkin_core.bench.peers import Peer, Runner, hold_blas_to_one_thread
from physkin_core.bound_garment import BoundGarment
from physkin_core.skinning import skin, skinning_matrices

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
    turned = np.einsum("nij,nj->ni", blended[:, :, :3], normals)
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
            turned = torch.bmm(blended[..., :3], normals[..., None])[..., 0]
            out[:, 3:] = torch.nn.functional.normalize(turned, dim=1)

    return Runner(run, lambda: out.numpy())


@cache
def _numba_kernel():
    import numba

    zero, one = np.float32(0), np.float32(1)

    @numba.njit(fastmath=True, boundscheck=False)
    def kernel(matrices, nodes, weights, vertices, normals, out):
        for v in range(vertices.shape[0]):
            a = b = c = d = e = f = g = h = i = j = k = l = zero  # noqa: E741 (the twelve numbers of a matrix)
            for influence in range(nodes.shape[1]):
                w, m = weights[v, influence], nodes[v, influence]
                a, b, c, d = (
                    a + w * matrices[m, 0],
                    b + w * matrices[m, 1],
                    c + w * matrices[m, 2],
                    d + w * matrices[m, 3],
                )
                e, f, g, h = (
                    e + w * matrices[m, 4],
                    f + w * matrices[m, 5],
                    g + w * matrices[m, 6],
                    h + w * matrices[m, 7],
                )
                i, j, k, l = (
                    i + w * matrices[m, 8],
                    j + w * matrices[m, 9],
                    k + w * matrices[m, 10],
                    l + w * matrices[m, 11],
                )  # noqa: E741
            x, y, z = vertices[v, 0], vertices[v, 1], vertices[v, 2]
            out[v, 0] = a * x + b * y + c * z + d
            out[v, 1] = e * x + f * y + g * z + h
            out[v, 2] = i * x + j * y + k * z + l
            x, y, z = normals[v, 0], normals[v, 1], normals[v, 2]
            p, q, r = a * x + b * y + c * z, e * x + f * y + g * z, i * x + j * y + k * z
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
        point, direction = wp.vec4(x[0], x[1], x[2], 1.0), wp.vec4(n[0], n[1], n[2], 0.0)
        out[v, 0] = wp.vec3(wp.dot(a, point), wp.dot(b, point), wp.dot(c, point))
        out[v, 1] = wp.normalize(wp.vec3(wp.dot(a, direction), wp.dot(b, direction), wp.dot(c, direction)))

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
