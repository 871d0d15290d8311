"""Bending of hinges, pairs of faces with a common edge: k (theta - rest)^2 (Grinspun et al. 2003)."""

from __future__ import annotations

import torch
import warp as wp

from physkin_training.energies.energy import Blocks, Cloth, Drapes, Energy

__all__ = ["Bend"]

wp.set_module_options({"enable_backward": False})


@wp.func
def squared_length(normal: wp.vec3) -> wp.float32:
    return wp.max(wp.dot(normal, normal), 1.0e-16)


@wp.func
def angle_beyond(e: wp.vec3, a: wp.vec3, b: wp.vec3, rest: wp.float32) -> wp.float32:
    """Dihedral angle of a hinge with e = x1 - x0, a = x2 - x0, b = x3 - x0, less that at rest, in -pi to pi."""
    na = wp.cross(e, a)
    nb = wp.cross(b, e)
    angle = wp.atan2(wp.dot(wp.cross(na, nb), e) / wp.max(wp.length(e), 1.0e-9), wp.dot(na, nb)) - rest
    return angle - 2.0 * wp.pi * wp.round(angle / (2.0 * wp.pi))


@wp.func
def angle_gradient(
    x0: wp.vec3, x1: wp.vec3, x2: wp.vec3, x3: wp.vec3, scale: wp.float32
) -> tuple[wp.vec3, wp.vec3, wp.vec3, wp.vec3]:
    """The angle's gradient at the hinge's four corners, times a scale."""
    edge = x1 - x0
    length = wp.max(wp.length(edge), 1.0e-9)
    na = wp.cross(edge, x2 - x0)
    nb = wp.cross(x3 - x0, edge)
    ga = na * (scale / squared_length(na))
    gb = nb * (scale / squared_length(nb))
    g0 = (ga * wp.dot(x2 - x1, edge) + gb * wp.dot(x3 - x1, edge)) / -length
    g1 = (ga * wp.dot(x2 - x0, edge) + gb * wp.dot(x3 - x0, edge)) / length
    return g0, g1, ga * -length, gb * -length


@wp.kernel
def bend_kernel(
    x: wp.array2d(dtype=wp.vec3),
    rest_row: wp.array(dtype=wp.int32),
    hinges: wp.array2d(dtype=wp.int32),
    rest_angle: wp.array2d(dtype=wp.float32),
    stiffness: wp.array2d(dtype=wp.float32),
    stiffer: wp.array(dtype=wp.float32),
    energy: wp.array2d(dtype=wp.float32),
    gradient: wp.array2d(dtype=wp.vec3),
):
    """One hinge of one sample."""
    s, t = wp.tid()
    i0, i1, i2, i3 = hinges[t, 0], hinges[t, 1], hinges[t, 2], hinges[t, 3]
    x0, x1, x2, x3 = x[s, i0], x[s, i1], x[s, i2], x[s, i3]
    angle = angle_beyond(x1 - x0, x2 - x0, x3 - x0, rest_angle[rest_row[s], t])
    k = stiffness[rest_row[s], t] * stiffer[s]
    energy[s, t] = k * angle * angle
    g0, g1, g2, g3 = angle_gradient(x0, x1, x2, x3, 2.0 * k * angle)
    wp.atomic_add(gradient, s, i2, g2)
    wp.atomic_add(gradient, s, i3, g3)
    wp.atomic_add(gradient, s, i0, g0)
    wp.atomic_add(gradient, s, i1, g1)


@wp.func
def angle_gradient_change(
    e: wp.vec3, a: wp.vec3, b: wp.vec3, de: wp.vec3, da: wp.vec3, db: wp.vec3
) -> tuple[wp.vec3, wp.vec3, wp.vec3]:
    """Change of the angle's gradient at corners 1, 2, 3 when e = x1 - x0, a = x2 - x0, b = x3 - x0 change by de, da,
    db."""
    length = wp.length(e)
    dlength = wp.dot(e, de) / length
    na = wp.cross(e, a)
    nb = wp.cross(b, e)
    dna = wp.cross(de, a) + wp.cross(e, da)
    dnb = wp.cross(db, e) + wp.cross(b, de)
    na2 = squared_length(na)
    nb2 = squared_length(nb)
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
    rest_row: wp.array(dtype=wp.int32),
    hinges: wp.array2d(dtype=wp.int32),
    rest_angle: wp.array2d(dtype=wp.float32),
    stiffness: wp.array2d(dtype=wp.float32),
    stiffer: wp.array(dtype=wp.float32),
    slots: wp.array2d(dtype=wp.int32),
    blocks: wp.array2d(dtype=wp.mat33),
):
    """2 k (grad theta grad theta^T), which is positive, and for exact blocks 2 k (theta - rest) hess theta."""
    s, t = wp.tid()
    if not active[s]:
        return
    x0, x1, x2, x3 = x[s, hinges[t, 0]], x[s, hinges[t, 1]], x[s, hinges[t, 2]], x[s, hinges[t, 3]]
    g0, g1, g2, g3 = angle_gradient(x0, x1, x2, x3, 1.0)
    k = 2.0 * stiffness[rest_row[s], t] * stiffer[s]
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
        e, a, b = x1 - x0, x2 - x0, x3 - x0
        k = k * angle_beyond(e, a, b, rest_angle[rest_row[s], t])
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


class Bend(Energy):
    """Against the rest shapes' `hinge_angle`, by their `bend_stiffness`. stiffer: (B,), how many times as stiffly each
    sample's cloth bends; may be changed in place."""

    name = "bend"

    def __init__(self, cloth: Cloth) -> None:
        super().__init__(cloth, cloth.garment.hinges)
        self.stiffer = torch.ones(len(cloth.rest_row), device=cloth.device)
        hinges = cloth.array(self.elements, wp.int32)
        rest = wp.from_torch(cloth.rest.hinge_angle), wp.from_torch(cloth.rest.bend_stiffness)
        self._hinges = (cloth.row, hinges, *rest, wp.from_torch(self.stiffer))

    def evaluate(self, drapes: Drapes) -> None:
        self._launch(bend_kernel, drapes.points, *self._hinges, self._energy, drapes.forces)

    def add_second_derivative(self, drapes: Drapes, blocks: Blocks) -> None:
        self._launch(
            bend_hessian_kernel,
            *(blocks.active, blocks.exact, drapes.points, *self._hinges, blocks.slots, blocks.all),
        )
