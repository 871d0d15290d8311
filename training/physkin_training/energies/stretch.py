"""Stretch: the StVK membrane of faces (Barbic and James 2005).

With E = (F^T F - I) / 2 a face's Green strain, its energy is A (mu E : E + lambda / 2 tr(E)^2).
"""

from physkin_training.energies.energy import Blocks, Cloth, Drapes, Energy, Rest
from physkin_training.quiet_warp import wp

__all__ = ["Stretch"]

wp.set_module_options({"enable_backward": False})


@wp.func
def deformation_columns(
    x: wp.array2d(dtype=wp.vec3), s: wp.int32, corners: wp.vec3i, inverse: wp.mat22
) -> tuple[wp.vec3, wp.vec3]:
    """Columns of a face's deformation gradient F."""
    x0 = x[s, corners[0]]
    d1 = x[s, corners[1]] - x0
    d2 = x[s, corners[2]] - x0
    return d1 * inverse[0, 0] + d2 * inverse[1, 0], d1 * inverse[0, 1] + d2 * inverse[1, 1]


@wp.func
def green_strain(f1: wp.vec3, f2: wp.vec3) -> wp.vec3:
    """Entries 11, 22, 12 of the strain E of a deformation gradient with these columns."""
    return wp.vec3(0.5 * (wp.dot(f1, f1) - 1.0), 0.5 * (wp.dot(f2, f2) - 1.0), 0.5 * wp.dot(f1, f2))


@wp.func
def strain_of(
    f1: wp.vec3,
    f2: wp.vec3,
    unstressed: wp.array2d(dtype=wp.vec3),
    s: wp.int32,
    corners: wp.vec3i,
    inverse: wp.mat22,
) -> wp.vec3:
    """The strain, or where there are `unstressed` vertices, its difference from theirs."""
    e = green_strain(f1, f2)
    if unstressed.shape[0] > 0:
        u1, u2 = deformation_columns(unstressed, s, corners, inverse)
        e = e - green_strain(u1, u2)
    return e


@wp.func
def membrane_stress(e: wp.vec3, mu: wp.float32, lam: wp.float32) -> wp.vec3:
    """Entries 11, 22, 12 of the second Piola-Kirchhoff stress S."""
    trace = e[0] + e[1]
    return wp.vec3(2.0 * mu * e[0] + lam * trace, 2.0 * mu * e[1] + lam * trace, 2.0 * mu * e[2])


@wp.kernel
def membrane_kernel(
    rest: Rest,
    drapes: Drapes,
    faces: wp.array2d(dtype=wp.int32),
    unstressed: wp.array2d(dtype=wp.vec3),
    mu: wp.float32,
    lam: wp.float32,
    energy: wp.array2d(dtype=wp.float32),
):
    """One face of one sample: its force is A F S. Against the rest shape, it also adds its normal to its corners'."""
    s, t = wp.tid()
    corners = wp.vec3i(faces[t, 0], faces[t, 1], faces[t, 2])
    inverse = rest.inverse[rest.row[s], t]
    area = rest.face_area[rest.row[s], t]
    f1, f2 = deformation_columns(drapes.x, s, corners, inverse)
    e = strain_of(f1, f2, unstressed, s, corners, inverse)
    trace = e[0] + e[1]
    energy[s, t] = area * (mu * (e[0] * e[0] + e[1] * e[1] + 2.0 * e[2] * e[2]) + 0.5 * lam * trace * trace)
    stress = membrane_stress(e, mu, lam)
    p1 = (f1 * stress[0] + f2 * stress[2]) * area
    p2 = (f1 * stress[2] + f2 * stress[1]) * area
    g1 = p1 * inverse[0, 0] + p2 * inverse[0, 1]
    g2 = p1 * inverse[1, 0] + p2 * inverse[1, 1]
    wp.atomic_add(drapes.gradient, s, corners[1], g1)
    wp.atomic_add(drapes.gradient, s, corners[2], g2)
    wp.atomic_add(drapes.gradient, s, corners[0], -g1 - g2)
    if unstressed.shape[0] == 0:
        x0 = drapes.x[s, corners[0]]
        normal = wp.cross(drapes.x[s, corners[1]] - x0, drapes.x[s, corners[2]] - x0)
        for corner in range(3):
            wp.atomic_add(drapes.normals, s, corners[corner], normal)


@wp.func
def positive_part(s: wp.vec3) -> wp.vec3:
    """Entries 11, 22, 12 of a symmetric matrix with its negative eigenvalues set to zero."""
    middle = 0.5 * (s[0] + s[1])
    half = 0.5 * (s[0] - s[1])
    radius = wp.sqrt(half * half + s[2] * s[2])
    if middle - radius >= 0.0:
        return s
    if middle + radius <= 0.0:
        return wp.vec3(0.0, 0.0, 0.0)
    scale = 0.5 * (middle + radius) / radius
    return wp.vec3(scale * (radius + half), scale * (radius - half), scale * s[2])


@wp.func
def corner_gradient(inverse: wp.mat22, corner: wp.int32) -> wp.vec2:
    """Derivative of the deformation gradient's columns by a corner's position."""
    if corner == 1:
        return wp.vec2(inverse[0, 0], inverse[0, 1])
    if corner == 2:
        return wp.vec2(inverse[1, 0], inverse[1, 1])
    return wp.vec2(-inverse[0, 0] - inverse[1, 0], -inverse[0, 1] - inverse[1, 1])


@wp.kernel
def membrane_hessian_kernel(
    rest: Rest,
    drapes: Drapes,
    faces: wp.array2d(dtype=wp.int32),
    unstressed: wp.array2d(dtype=wp.vec3),
    mu: wp.float32,
    lam: wp.float32,
    blocks: Blocks,
):
    """With F_i the columns of F, g_a a corner's gradient and u_a = F g_a, the block of corners a, b is
    A ((g_a . S g_b) I + lam u_a u_b^T + mu (u_b u_a^T + (g_a . g_b) F F^T)); its first term alone can be negative, and
    is made positive by leaving compression out of the stress S."""
    s, t = wp.tid()
    if not blocks.active[s]:
        return
    corners = wp.vec3i(faces[t, 0], faces[t, 1], faces[t, 2])
    inverse = rest.inverse[rest.row[s], t]
    area = rest.face_area[rest.row[s], t]
    f1, f2 = deformation_columns(drapes.x, s, corners, inverse)
    stress = membrane_stress(strain_of(f1, f2, unstressed, s, corners, inverse), mu, lam)
    if not blocks.exact[s]:
        stress = positive_part(stress)
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
            wp.atomic_add(blocks.all, s, blocks.slots[t, 3 * a + b], area * block)


class Stretch(Energy):
    """Against the rest shapes' `rest_inverse` and `face_area`. unstressed: None, or vertices (B, n, 3) whose strain
    is without stress, in place of the rest shape's."""

    name = "stretch"

    def __init__(self, cloth: Cloth, *, unstressed: wp.array | None = None) -> None:
        super().__init__(cloth, cloth.garment.faces)
        self._unstressed = unstressed

    @property
    def lame(self) -> tuple[float, float]:
        """mu and lambda [N/m]."""
        return self.cloth.lame

    def evaluate(self, drapes: Drapes) -> None:
        given = self._rest, drapes, self._elements, self._unstressed, *self.lame
        self._launch(membrane_kernel, *given, self._energy)

    def add_second_derivative(self, drapes: Drapes, blocks: Blocks) -> None:
        given = self._rest, drapes, self._elements, self._unstressed, *self.lame
        self._launch(membrane_hessian_kernel, *given, blocks)
