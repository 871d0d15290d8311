"""Bending of hinges, pairs of faces with a common edge: k (theta - rest)^2 (Grinspun et al. 2003)."""

import torch

from physkin_training.energies.energy import Blocks, Cloth, Drapes, Energy, Rest
from physkin_training.quiet_warp import wp

__all__ = ["Bend"]

wp.set_module_options({"enable_backward": False})

Corners = wp.types.matrix(shape=(4, 3), dtype=wp.float32)
"""A vector for each corner of a hinge."""


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
def angle_gradient(x0: wp.vec3, x1: wp.vec3, x2: wp.vec3, x3: wp.vec3, scale: wp.float32) -> Corners:
    """The angle's gradient at the hinge's four corners, times a scale."""
    edge = x1 - x0
    length = wp.max(wp.length(edge), 1.0e-9)
    na = wp.cross(edge, x2 - x0)
    nb = wp.cross(x3 - x0, edge)
    ga = na * (scale / squared_length(na))
    gb = nb * (scale / squared_length(nb))
    g0 = (ga * wp.dot(x2 - x1, edge) + gb * wp.dot(x3 - x1, edge)) / -length
    g1 = (ga * wp.dot(x2 - x0, edge) + gb * wp.dot(x3 - x0, edge)) / length
    return wp.matrix_from_rows(g0, g1, ga * -length, gb * -length)


@wp.kernel
def bend_kernel(
    rest: Rest,
    drapes: Drapes,
    hinges: wp.array2d(dtype=wp.int32),
    stiffer: wp.array(dtype=wp.float32),
    energy: wp.array2d(dtype=wp.float32),
):
    """One hinge of one sample."""
    s, t = wp.tid()
    x0, x1 = drapes.x[s, hinges[t, 0]], drapes.x[s, hinges[t, 1]]
    x2, x3 = drapes.x[s, hinges[t, 2]], drapes.x[s, hinges[t, 3]]
    angle = angle_beyond(x1 - x0, x2 - x0, x3 - x0, rest.hinge_angle[rest.row[s], t])
    k = rest.bend_stiffness[rest.row[s], t] * stiffer[s]
    energy[s, t] = k * angle * angle
    gradient = angle_gradient(x0, x1, x2, x3, 2.0 * k * angle)
    for corner in range(4):
        wp.atomic_add(drapes.gradient, s, hinges[t, corner], gradient[corner])


@wp.func
def angle_gradient_change(e: wp.vec3, a: wp.vec3, b: wp.vec3, corner: wp.int32, move: wp.vec3) -> Corners:
    """Change of the angle's gradient, with e = x1 - x0, a = x2 - x0, b = x3 - x0, when corner 1, 2 or 3 moves."""
    none = wp.vec3(0.0, 0.0, 0.0)
    de, da, db = wp.where(corner == 1, move, none), wp.where(corner == 2, move, none), wp.where(corner == 3, move, none)
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
    dg2 = -dlength * pa - length * dpa
    dg3 = -dlength * pb - length * dpb
    return wp.matrix_from_rows(-dg1 - dg2 - dg3, dg1, dg2, dg3)


@wp.kernel
def bend_hessian_kernel(
    rest: Rest,
    drapes: Drapes,
    hinges: wp.array2d(dtype=wp.int32),
    stiffer: wp.array(dtype=wp.float32),
    blocks: Blocks,
):
    """2 k (grad theta grad theta^T), which is positive, and for exact blocks 2 k (theta - rest) hess theta."""
    s, t = wp.tid()
    if not blocks.active[s]:
        return
    x0, x1 = drapes.x[s, hinges[t, 0]], drapes.x[s, hinges[t, 1]]
    x2, x3 = drapes.x[s, hinges[t, 2]], drapes.x[s, hinges[t, 3]]
    gradient = angle_gradient(x0, x1, x2, x3, 1.0)
    k = 2.0 * rest.bend_stiffness[rest.row[s], t] * stiffer[s]
    for row in range(4):
        for column in range(4):
            block = k * wp.outer(gradient[row], gradient[column])
            wp.atomic_add(blocks.all, s, blocks.slots[t, 4 * row + column], block)
    if blocks.exact[s]:
        e, a, b = x1 - x0, x2 - x0, x3 - x0
        k = k * angle_beyond(e, a, b, rest.hinge_angle[rest.row[s], t])
        for column in range(1, 4):
            along_x = angle_gradient_change(e, a, b, column, wp.vec3(1.0, 0.0, 0.0))
            along_y = angle_gradient_change(e, a, b, column, wp.vec3(0.0, 1.0, 0.0))
            along_z = angle_gradient_change(e, a, b, column, wp.vec3(0.0, 0.0, 1.0))
            for row in range(4):
                block = k * wp.matrix_from_cols(along_x[row], along_y[row], along_z[row])
                wp.atomic_add(blocks.all, s, blocks.slots[t, 4 * row + column], block)
                wp.atomic_add(blocks.all, s, blocks.slots[t, 4 * row], -block)


class Bend(Energy):
    """Against the rest shapes' `hinge_angle`, by their `bend_stiffness`. stiffer: (B,), how many times as stiffly each
    sample's cloth bends; may be changed in place."""

    name = "bend"

    def __init__(self, cloth: Cloth) -> None:
        super().__init__(cloth, cloth.garment.hinges)
        self.stiffer = torch.ones(len(cloth.rest_row), device=cloth.device)
        self._stiffer = wp.from_torch(self.stiffer)

    def evaluate(self, drapes: Drapes) -> None:
        self._launch(bend_kernel, self._rest, drapes, self._elements, self._stiffer, self._energy)

    def add_second_derivative(self, drapes: Drapes, blocks: Blocks) -> None:
        self._launch(bend_hessian_kernel, self._rest, drapes, self._elements, self._stiffer, blocks)
