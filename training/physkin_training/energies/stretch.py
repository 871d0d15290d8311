"""Stretch: the StVK membrane of faces (Barbic and James 2005).

With E = (F^T F - I) / 2 a face's Green strain, its energy is A (mu E : E + lambda / 2 tr(E)^2). Where few numbers move
a garment, its faces cannot buckle as cloth does, and would be stiff where it yields: of compression, which are E's
negative eigenvalues and a negative trace, a share of the stiffness may then be left (tension fields, Pipkin 1986).
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


@wp.struct
class Stiffness:
    """Lame's mu and lambda [N/m], and the share of them that is left under compression."""

    mu: wp.float32
    lam: wp.float32
    compressed: wp.float32


@wp.struct
class Principal:
    """Eigenvalues of a strain, first the larger, with the unit eigenvector n1 of it, n2 = (-n1[1], n1[0]), and how much
    of the stiffness is left of each, of shear between them, and of the trace."""

    e1: wp.float32
    e2: wp.float32
    n1: wp.vec2
    left1: wp.float32
    left2: wp.float32
    left_shear: wp.float32
    left_trace: wp.float32


@wp.func
def left_of(strain: wp.float32, compressed: wp.float32) -> wp.float32:
    if strain < 0.0:
        return compressed
    return 1.0


@wp.func
def principal(e: wp.vec3, compressed: wp.float32) -> Principal:
    """Of a strain with entries 11, 22, 12."""
    p = Principal()
    middle = 0.5 * (e[0] + e[1])
    half = 0.5 * (e[0] - e[1])
    radius = wp.sqrt(half * half + e[2] * e[2])
    p.e1 = middle + radius
    p.e2 = middle - radius
    p.n1 = wp.vec2(1.0, 0.0)
    p.left1 = left_of(p.e1, compressed)
    p.left2 = left_of(p.e2, compressed)
    p.left_trace = left_of(middle, compressed)
    p.left_shear = p.left_trace
    if radius > 1.0e-7:
        angle = 0.5 * wp.atan2(e[2], half)
        p.n1 = wp.vec2(wp.cos(angle), wp.sin(angle))
        p.left_shear = 0.5 * (p.left1 * p.e1 - p.left2 * p.e2) / radius
    return p


@wp.func
def membrane_energy(p: Principal, k: Stiffness) -> wp.float32:
    """For each area of a face [J/m2]."""
    trace = p.e1 + p.e2
    return k.mu * (p.left1 * p.e1 * p.e1 + p.left2 * p.e2 * p.e2) + 0.5 * k.lam * p.left_trace * trace * trace


@wp.func
def membrane_stress(p: Principal, k: Stiffness) -> wp.vec3:
    """Entries 11, 22, 12 of the second Piola-Kirchhoff stress S."""
    pressure = k.lam * p.left_trace * (p.e1 + p.e2)
    s1 = 2.0 * k.mu * p.left1 * p.e1 + pressure
    s2 = 2.0 * k.mu * p.left2 * p.e2 + pressure
    c = p.n1[0]
    s = p.n1[1]
    return wp.vec3(s1 * c * c + s2 * s * s, s1 * s * s + s2 * c * c, (s1 - s2) * c * s)


@wp.kernel
def membrane_kernel(
    rest: Rest,
    drapes: Drapes,
    faces: wp.array2d(dtype=wp.int32),
    unstressed: wp.array2d(dtype=wp.vec3),
    stiffness: Stiffness,
    energy: wp.array2d(dtype=wp.float32),
):
    """One face of one sample: its force is A F S. Against the rest shape, it also adds its normal to its corners'."""
    s, t = wp.tid()
    corners = wp.vec3i(faces[t, 0], faces[t, 1], faces[t, 2])
    inverse = rest.inverse[rest.row[s], t]
    area = rest.face_area[rest.row[s], t]
    f1, f2 = deformation_columns(drapes.x, s, corners, inverse)
    strain = principal(strain_of(f1, f2, unstressed, s, corners, inverse), stiffness.compressed)
    energy[s, t] = area * membrane_energy(strain, stiffness)
    stress = membrane_stress(strain, stiffness)
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
    stiffness: Stiffness,
    blocks: Blocks,
):
    """With g_a a corner's gradient, u_a = F g_a, and F n_i and g_a . n_i in the strain's principal axes, the block of
    corners a, b is A ((g_a . S g_b) I + lam u_a u_b^T + 2 mu dE_a : dE_b), dE the change of the strain; its first term
    alone can be negative, and is made positive by leaving compression out of the stress S."""
    s, t = wp.tid()
    if not blocks.active[s]:
        return
    corners = wp.vec3i(faces[t, 0], faces[t, 1], faces[t, 2])
    inverse = rest.inverse[rest.row[s], t]
    area = rest.face_area[rest.row[s], t]
    f1, f2 = deformation_columns(drapes.x, s, corners, inverse)
    strain = principal(strain_of(f1, f2, unstressed, s, corners, inverse), stiffness.compressed)
    stress = membrane_stress(strain, stiffness)
    if not blocks.exact[s]:
        stress = positive_part(stress)
    n1 = strain.n1
    n2 = wp.vec2(-n1[1], n1[0])
    h1 = f1 * n1[0] + f2 * n1[1]
    h2 = f1 * n2[0] + f2 * n2[1]
    identity = wp.identity(n=3, dtype=wp.float32)
    for a in range(3):
        ga = corner_gradient(inverse, a)
        a1 = wp.dot(ga, n1)
        a2 = wp.dot(ga, n2)
        for b in range(3):
            gb = corner_gradient(inverse, b)
            b1 = wp.dot(gb, n1)
            b2 = wp.dot(gb, n2)
            along = ga[0] * gb[0] * stress[0] + ga[1] * gb[1] * stress[1]
            along += (ga[0] * gb[1] + ga[1] * gb[0]) * stress[2]
            change = strain.left1 * a1 * b1 * wp.outer(h1, h1) + strain.left2 * a2 * b2 * wp.outer(h2, h2)
            change += 0.5 * strain.left_shear * wp.outer(h1 * a2 + h2 * a1, h1 * b2 + h2 * b1)
            trace = strain.left_trace * wp.outer(h1 * a1 + h2 * a2, h1 * b1 + h2 * b2)
            block = along * identity + stiffness.lam * trace + 2.0 * stiffness.mu * change
            wp.atomic_add(blocks.all, s, blocks.slots[t, 3 * a + b], area * block)


class Stretch(Energy):
    """Against the rest shapes' `rest_inverse` and `face_area`. unstressed: None, or vertices (B, n, 3) whose strain
    is without stress, in place of the rest shape's. `compressed`, which may be changed: the share of the stiffness that
    is left under compression."""

    name = "stretch"
    compressed = 1.0

    def __init__(self, cloth: Cloth, *, unstressed: wp.array | None = None) -> None:
        super().__init__(cloth, cloth.garment.faces)
        self._unstressed = unstressed

    @property
    def lame(self) -> tuple[float, float]:
        """mu and lambda [N/m]."""
        return self.cloth.lame

    @property
    def stiffness(self) -> Stiffness:
        stiffness = Stiffness()
        stiffness.mu, stiffness.lam = self.lame
        stiffness.compressed = self.compressed
        return stiffness

    def evaluate(self, drapes: Drapes) -> None:
        given = self._rest, drapes, self._elements, self._unstressed, self.stiffness
        self._launch(membrane_kernel, *given, self._energy)

    def add_second_derivative(self, drapes: Drapes, blocks: Blocks) -> None:
        given = self._rest, drapes, self._elements, self._unstressed, self.stiffness
        self._launch(membrane_hessian_kernel, *given, blocks)
