"""Second derivatives of the physics losses: one 3 x 3 block for every pair of vertices that share a face or a hinge.

Warp kernels write the blocks of all samples into block-sparse rows of one pattern. The blocks come in two kinds, chosen
for each sample: exact ones, or ones made positive semidefinite element by element, so that a step downhill always
exists. Contact blocks are positive semidefinite in either case: the closest surface point is taken to be on a plane.

Dimensions: `B` samples, `n` garment vertices, `f` faces, `q` hinges, `z` blocks. Metres, newtons.
"""

from __future__ import annotations

import numpy as np
import torch
import warp as wp

from physkin_core.model.garment import Garment
from physkin_training.physics.energy_kernels import deformation_columns
from physkin_training.physics.physics_losses import PhysicsLosses

__all__ = ["EnergyHessian"]


@wp.func
def positive_part(s11: wp.float32, s22: wp.float32, s12: wp.float32) -> wp.vec3:
    """Entries 11, 22, 12 of a symmetric matrix with its negative eigenvalues set to zero."""
    middle = 0.5 * (s11 + s22)
    half = 0.5 * (s11 - s22)
    radius = wp.sqrt(half * half + s12 * s12)
    if middle - radius >= 0.0:
        return wp.vec3(s11, s22, s12)
    if middle + radius <= 0.0:
        return wp.vec3(0.0, 0.0, 0.0)
    scale = 0.5 * (middle + radius) / radius
    return wp.vec3(scale * (radius + half), scale * (radius - half), scale * s12)


@wp.func
def corner_gradient(inverse: wp.mat22, corner: wp.int32) -> wp.vec2:
    """Derivative of the deformation gradient's columns by a corner's position."""
    if corner == 1:
        return wp.vec2(inverse[0, 0], inverse[0, 1])
    if corner == 2:
        return wp.vec2(inverse[1, 0], inverse[1, 1])
    return wp.vec2(-inverse[0, 0] - inverse[1, 0], -inverse[0, 1] - inverse[1, 1])


@wp.kernel
def stretch_hessian_kernel(
    active: wp.array(dtype=wp.bool),
    exact: wp.array(dtype=wp.bool),
    x: wp.array2d(dtype=wp.vec3),
    faces: wp.array2d(dtype=wp.int32),
    slots: wp.array2d(dtype=wp.int32),
    rest_row: wp.array(dtype=wp.int32),
    rest_inverse: wp.array2d(dtype=wp.mat22),
    rest_area: wp.array2d(dtype=wp.float32),
    mu: wp.float32,
    lam: wp.float32,
    blocks: wp.array2d(dtype=wp.mat33),
):
    """StVK membrane. With F_i the columns of F, g_a a corner's gradient and u_a = F g_a, the block of corners a, b is
    A ((g_a . S g_b) I + lam u_a u_b^T + mu (u_b u_a^T + (g_a . g_b) F F^T)); its first term alone can be negative, and
    is made positive by leaving compression out of the stress S."""
    s, t = wp.tid()
    if not active[s]:
        return
    x0 = x[s, faces[t, 0]]
    d1 = x[s, faces[t, 1]] - x0
    d2 = x[s, faces[t, 2]] - x0
    inverse = rest_inverse[rest_row[s], t]
    area = rest_area[rest_row[s], t]
    f1, f2 = deformation_columns(d1, d2, inverse)
    e11 = 0.5 * (wp.dot(f1, f1) - 1.0)
    e22 = 0.5 * (wp.dot(f2, f2) - 1.0)
    trace = e11 + e22
    stress = wp.vec3(2.0 * mu * e11 + lam * trace, 2.0 * mu * e22 + lam * trace, mu * wp.dot(f1, f2))
    if not exact[s]:
        stress = positive_part(stress[0], stress[1], stress[2])
    left = wp.outer(f1, f1) + wp.outer(f2, f2)
    identity = wp.identity(n=3, dtype=wp.float32)
    for a in range(3):
        ga = corner_gradient(inverse, a)
        ua = f1 * ga[0] + f2 * ga[1]
        for b in range(3):
            gb = corner_gradient(inverse, b)
            ub = f1 * gb[0] + f2 * gb[1]
            along = ga[0] * gb[0] * stress[0] + ga[1] * gb[1] * stress[1]
            along += (ga[0] * gb[1] + ga[1] * gb[0]) * stress[2]
            block = along * identity + lam * wp.outer(ua, ub) + mu * (wp.outer(ub, ua) + wp.dot(ga, gb) * left)
            wp.atomic_add(blocks, s, slots[t, 3 * a + b], area * block)


@wp.func
def angle_gradient_change(
    e: wp.vec3, a: wp.vec3, b: wp.vec3, de: wp.vec3, da: wp.vec3, db: wp.vec3
) -> tuple[wp.vec3, wp.vec3, wp.vec3]:
    """Change of the dihedral angle's gradient at corners 1, 2, 3 of a hinge when e = x1 - x0, a = x2 - x0, b = x3 - x0
    change by de, da, db."""
    length = wp.length(e)
    dlength = wp.dot(e, de) / length
    na = wp.cross(e, a)
    nb = wp.cross(b, e)
    dna = wp.cross(de, a) + wp.cross(e, da)
    dnb = wp.cross(db, e) + wp.cross(b, de)
    na2 = wp.max(wp.dot(na, na), 1.0e-16)
    nb2 = wp.max(wp.dot(nb, nb), 1.0e-16)
    pa = na / na2
    pb = nb / nb2
    dpa = (dna - 2.0 * wp.dot(na, dna) * pa) / na2
    dpb = (dnb - 2.0 * wp.dot(nb, dnb) * pb) / nb2
    g1 = (pa * wp.dot(a, e) + pb * wp.dot(b, e)) / length
    dg1 = dpa * wp.dot(a, e) + dpb * wp.dot(b, e)
    dg1 += pa * (wp.dot(da, e) + wp.dot(a, de)) + pb * (wp.dot(db, e) + wp.dot(b, de))
    dg1 = (dg1 - g1 * dlength) / length
    return dg1, -dlength * pa - length * dpa, -dlength * pb - length * dpb


@wp.kernel
def bend_hessian_kernel(
    active: wp.array(dtype=wp.bool),
    exact: wp.array(dtype=wp.bool),
    x: wp.array2d(dtype=wp.vec3),
    hinges: wp.array2d(dtype=wp.int32),
    slots: wp.array2d(dtype=wp.int32),
    rest_row: wp.array(dtype=wp.int32),
    rest_angle: wp.array2d(dtype=wp.float32),
    stiffness: wp.array2d(dtype=wp.float32),
    blocks: wp.array2d(dtype=wp.mat33),
):
    """2 k (grad theta grad theta^T), which is positive, and for exact blocks 2 k (theta - rest) hess theta."""
    s, t = wp.tid()
    if not active[s]:
        return
    x0 = x[s, hinges[t, 0]]
    e = x[s, hinges[t, 1]] - x0
    a = x[s, hinges[t, 2]] - x0
    b = x[s, hinges[t, 3]] - x0
    length = wp.max(wp.length(e), 1.0e-9)
    na = wp.cross(e, a)
    nb = wp.cross(b, e)
    na2 = wp.max(wp.dot(na, na), 1.0e-16)
    nb2 = wp.max(wp.dot(nb, nb), 1.0e-16)
    g2 = na * (-length / na2)
    g3 = nb * (-length / nb2)
    g1 = (na * (wp.dot(a, e) / na2) + nb * (wp.dot(b, e) / nb2)) / length
    g0 = -g1 - g2 - g3
    k = 2.0 * stiffness[rest_row[s], t]
    for row in range(4):
        gr = g0
        if row == 1:
            gr = g1
        if row == 2:
            gr = g2
        if row == 3:
            gr = g3
        wp.atomic_add(blocks, s, slots[t, 4 * row], k * wp.outer(gr, g0))
        wp.atomic_add(blocks, s, slots[t, 4 * row + 1], k * wp.outer(gr, g1))
        wp.atomic_add(blocks, s, slots[t, 4 * row + 2], k * wp.outer(gr, g2))
        wp.atomic_add(blocks, s, slots[t, 4 * row + 3], k * wp.outer(gr, g3))
    if exact[s]:
        angle = wp.atan2(wp.dot(wp.cross(na, nb), e) / length, wp.dot(na, nb)) - rest_angle[rest_row[s], t]
        angle = angle - 2.0 * wp.pi * wp.round(angle / (2.0 * wp.pi))
        k = k * angle
        identity = wp.identity(n=3, dtype=wp.float32)
        zero = wp.vec3(0.0, 0.0, 0.0)
        for column in range(1, 4):
            h1 = wp.mat33(0.0)
            h2 = wp.mat33(0.0)
            h3 = wp.mat33(0.0)
            for axis in range(3):
                move = identity[axis]
                de, da, db = zero, zero, zero
                if column == 1:
                    de = move
                if column == 2:
                    da = move
                if column == 3:
                    db = move
                dg1, dg2, dg3 = angle_gradient_change(e, a, b, de, da, db)
                h1 += wp.outer(dg1, move)
                h2 += wp.outer(dg2, move)
                h3 += wp.outer(dg3, move)
            h0 = -h1 - h2 - h3
            wp.atomic_add(blocks, s, slots[t, column], k * h0)
            wp.atomic_add(blocks, s, slots[t, 4 + column], k * h1)
            wp.atomic_add(blocks, s, slots[t, 8 + column], k * h2)
            wp.atomic_add(blocks, s, slots[t, 12 + column], k * h3)
            wp.atomic_add(blocks, s, slots[t, 0], -k * h0)
            wp.atomic_add(blocks, s, slots[t, 4], -k * h1)
            wp.atomic_add(blocks, s, slots[t, 8], -k * h2)
            wp.atomic_add(blocks, s, slots[t, 12], -k * h3)


@wp.kernel
def contact_hessian_kernel(
    active: wp.array(dtype=wp.bool),
    x: wp.array2d(dtype=wp.vec3),
    body: wp.uint64,
    body_offset: wp.array(dtype=wp.vec3),
    energy: wp.array2d(dtype=wp.float32),
    rest_row: wp.array(dtype=wp.int32),
    vertex_area: wp.array2d(dtype=wp.float32),
    stiffness: wp.array(dtype=wp.float32),
    reach: wp.float32,
    diagonal: wp.array(dtype=wp.int32),
    gradient: wp.array2d(dtype=wp.vec3),
    blocks: wp.array2d(dtype=wp.mat33),
):
    """2 k A (outward outward^T) of every vertex whose contact energy was above zero; the losses decide which."""
    s, v = wp.tid()
    if not active[s]:
        return
    gradient[s, v] = wp.vec3(0.0, 0.0, 0.0)
    if energy[s, v] <= 0.0:
        return
    point = x[s, v] + body_offset[s]
    hit = wp.mesh_query_point_no_sign(body, point, reach)
    if hit.result:
        away = point - wp.mesh_eval_position(body, hit.face, hit.u, hit.v)
        gap = wp.length(away)
        outward = wp.mesh_eval_face_normal(body, hit.face)
        if gap > 1.0e-6:
            outward = away / gap
        k = 2.0 * stiffness[0] * vertex_area[rest_row[s], v]
        gradient[s, v] = -wp.sqrt(2.0 * k * energy[s, v]) * outward
        blocks[s, diagonal[v]] = blocks[s, diagonal[v]] + k * wp.outer(outward, outward)


@wp.kernel
def multiply_kernel(
    active: wp.array(dtype=wp.bool),
    row_start: wp.array(dtype=wp.int32),
    columns: wp.array(dtype=wp.int32),
    blocks: wp.array2d(dtype=wp.mat33),
    x: wp.array2d(dtype=wp.vec3),
    product: wp.array2d(dtype=wp.vec3),
):
    """One block row of one sample times a vector."""
    s, v = wp.tid()
    if not active[s]:
        return
    total = wp.vec3(0.0, 0.0, 0.0)
    for k in range(row_start[v], row_start[v + 1]):
        total += blocks[s, k] * x[s, columns[k]]
    product[s, v] = total


@wp.kernel
def damp_and_invert_kernel(
    active: wp.array(dtype=wp.bool),
    extra: wp.array2d(dtype=wp.mat33),
    damping: wp.array(dtype=wp.float32),
    scale: wp.array(dtype=wp.float32),
    diagonal: wp.array(dtype=wp.int32),
    blocks: wp.array2d(dtype=wp.mat33),
    inverse: wp.array2d(dtype=wp.mat33),
):
    """Add the damping to one diagonal block, and invert the block for the preconditioner."""
    s, v = wp.tid()
    if not active[s]:
        return
    identity = wp.identity(n=3, dtype=wp.float32)
    block = blocks[s, diagonal[v]] + extra[s, v] + damping[s] * scale[v] * identity
    blocks[s, diagonal[v]] = block
    size = wp.trace(block) / 3.0
    positive = block[0, 0] > 0.0 and block[0, 0] * block[1, 1] > block[0, 1] * block[1, 0]
    if positive and wp.determinant(block) > 1.0e-6 * size * size * size:
        inverse[s, v] = wp.inverse(block)
    else:
        inverse[s, v] = identity / wp.max(wp.abs(size), 1.0e-6)


class EnergyHessian:
    """Block-sparse second derivative of the physics losses of one garment, for a fixed number of samples.

    `active` (B,) bool: samples that `assemble` and `multiply` work on; the others' results are left as they are.
    """

    def __init__(self, garment: Garment, losses: PhysicsLosses, samples: int, device: torch.device) -> None:
        self.losses = losses
        self.device = wp.device_from_torch(device)
        n = len(garment.vertices)
        young, poisson = losses.material.youngs_modulus, losses.material.poisson_ratio
        self._mu = young / (2 * (1 + poisson))
        self._lam = young * poisson / (1 - poisson**2)
        pattern, slots = _pattern([garment.faces, garment.hinges, np.arange(n)[:, None]], n)

        def array(values: np.ndarray, dtype) -> wp.array:
            scalar = np.int32 if dtype is wp.int32 else np.float32
            return wp.array(np.ascontiguousarray(values, dtype=scalar), dtype=dtype, device=self.device)

        self._columns = array(pattern % n, wp.int32)
        self._row_start = array(np.searchsorted(pattern, np.arange(n + 1) * n), wp.int32)
        self._face_slots, self._hinge_slots = array(slots[0], wp.int32), array(slots[1], wp.int32)
        self._diagonal = array(slots[2][:, 0], wp.int32)
        self._faces, self._hinges = array(garment.faces, wp.int32), array(garment.hinges, wp.int32)
        self._vertex_area = array(garment.vertex_areas, wp.float32)
        self._blocks = torch.zeros(samples, len(pattern), 3, 3, device=device)
        self._inverse = torch.zeros(samples, n, 3, 3, device=device)
        self.contact_gradient = torch.zeros(samples, n, 3, device=device)
        self.active = torch.ones(samples, dtype=torch.bool, device=device)

    def assemble(self, x: torch.Tensor, body: wp.Mesh, body_offset: torch.Tensor, exact: torch.Tensor) -> None:
        """Compute the blocks at x (B, n, 3), which the losses have been evaluated at last.

        exact: (B,) bool, else every element's block is made positive semidefinite.
        """
        samples, n, _ = x.shape
        self._blocks[self.active] = 0.0
        points, blocks = wp.from_torch(x.contiguous(), dtype=wp.vec3), self._matrices(self._blocks)
        active, exact = wp.from_torch(self.active), wp.from_torch(exact)
        rest, row = self.losses.rest, wp.from_torch(self.losses.rest_row)
        wp.launch(
            stretch_hessian_kernel,
            dim=(samples, self._faces.shape[0]),
            inputs=[
                *(active, exact, points, self._faces, self._face_slots, row),
                *(wp.from_torch(rest.rest_inverse, dtype=wp.mat22), wp.from_torch(rest.face_area)),
                *(self._mu, self._lam),
            ],
            outputs=[blocks],
            device=self.device,
        )
        wp.launch(
            bend_hessian_kernel,
            dim=(samples, self._hinges.shape[0]),
            inputs=[
                *(active, exact, points, self._hinges, self._hinge_slots, row),
                *(wp.from_torch(rest.hinge_angle), wp.from_torch(rest.bend_stiffness)),
            ],
            outputs=[blocks],
            device=self.device,
        )
        wp.launch(
            contact_hessian_kernel,
            dim=(samples, n),
            inputs=[
                *(active, points, body.id, wp.from_torch(body_offset, dtype=wp.vec3)),
                *(wp.from_torch(self.losses.element_energies["collision"]), row, wp.from_torch(rest.vertex_area)),
                *(wp.from_torch(self.losses.contact_stiffness), self.losses.reach, self._diagonal),
            ],
            outputs=[wp.from_torch(self.contact_gradient, dtype=wp.vec3), blocks],
            device=self.device,
        )

    def add_to_diagonal(self, blocks: torch.Tensor, damping: torch.Tensor) -> None:
        """Add a block for every vertex (B, n, 3, 3), and its area times the damping (B,) [N/m3].

        `precondition` needs it, be both zero.
        """
        wp.launch(
            damp_and_invert_kernel,
            dim=self._inverse.shape[:2],
            inputs=[
                *(wp.from_torch(self.active), self._matrices(blocks), wp.from_torch(damping)),
                *(self._vertex_area, self._diagonal),
            ],
            outputs=[self._matrices(self._blocks), self._matrices(self._inverse)],
            device=self.device,
        )

    def multiply(self, x: torch.Tensor, product: torch.Tensor) -> None:
        """Write H x into `product`, both (B, n, 3)."""
        wp.launch(
            multiply_kernel,
            dim=x.shape[:2],
            inputs=[
                *(wp.from_torch(self.active), self._row_start, self._columns, self._matrices(self._blocks)),
                wp.from_torch(x, dtype=wp.vec3),
            ],
            outputs=[wp.from_torch(product, dtype=wp.vec3)],
            device=self.device,
        )

    def precondition(self, x: torch.Tensor) -> torch.Tensor:
        """Inverse of the diagonal blocks times x (B, n, 3)."""
        return (self._inverse * x[:, :, None, :]).sum(dim=-1)

    @property
    def diagonal_blocks(self) -> torch.Tensor:
        """(B, n, 3, 3), of the shape that `add_to_diagonal` takes: the inverses it made last."""
        return self._inverse

    def _matrices(self, tensor: torch.Tensor) -> wp.array:
        return wp.from_torch(tensor, dtype=wp.mat33)


def _pattern(elements: list[np.ndarray], n: int) -> tuple[np.ndarray, list[np.ndarray]]:
    """Sorted keys row * n + column (z,) of the blocks that elements (e, corners) need, and where each element's
    corners * corners blocks lie among them."""
    keys = [
        (element[:, :, None].astype(np.int64) * n + element[:, None, :]).reshape(len(element), element.shape[1] ** 2)
        for element in elements
    ]
    pattern = np.unique(np.concatenate([key.reshape(-1) for key in keys]))
    return pattern, [np.searchsorted(pattern, key) for key in keys]
