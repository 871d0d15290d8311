"""The energies as Warp kernels, with gradients written by hand (paper: Training): stretch, bend, collision, gravity,
and a band that holds the garment up.

Each kernel writes the energy [J] of its elements and adds dE/dx [N] to a shared gradient array in one pass. `rest_row`
says which rest shape of the tables a sample has.
"""

import warp as wp

__all__ = [
    "BAND_SLACK",
    "BAND_STIFFNESS",
    "DEEP",
    "LED_BACK_BEYOND",
    "add_membrane_forces",
    "band_kernel",
    "bend_kernel",
    "collision_kernel",
    "deformation_columns",
    "gravity_kernel",
    "stretch_kernel",
]

DEEP = 0.01
"""Beyond this depth [m] below the contact offset a hit counts only if the vertex is worn on that part of the body, and
body and cloth face the same way: else it is another limb, or the wrong side of this one."""

LED_BACK_BEYOND = 0.001
"""Depth [m] behind its own place on the body up to which the force grows that leads a lost vertex back."""

BAND_STIFFNESS = 1.0e5
"""What holds a garment up [J/m4]: energy = stiffness * vertex area * (distance beyond the slack)^2."""

BAND_SLACK = 0.015
"""How far [m] a vertex of the band may move from its place on the body before it is held."""


@wp.func
def deformation_columns(d1: wp.vec3, d2: wp.vec3, inverse: wp.mat22) -> tuple[wp.vec3, wp.vec3]:
    """Columns of a face's deformation gradient F, of its sides d1 = x_b - x_a and d2 = x_c - x_a."""
    return d1 * inverse[0, 0] + d2 * inverse[1, 0], d1 * inverse[0, 1] + d2 * inverse[1, 1]


@wp.func
def add_membrane_forces(
    gradient: wp.array2d(dtype=wp.vec3),
    s: wp.int32,
    corners: wp.vec3i,
    f1: wp.vec3,
    f2: wp.vec3,
    stress: wp.vec3,
    inverse: wp.mat22,
    area: wp.float32,
):
    """Add a face's A F S to the gradient at its corners. f1, f2: columns of F. stress: entries 11, 22, 12 of S."""
    p1 = (f1 * stress[0] + f2 * stress[2]) * area
    p2 = (f1 * stress[2] + f2 * stress[1]) * area
    g1 = p1 * inverse[0, 0] + p2 * inverse[0, 1]
    g2 = p1 * inverse[1, 0] + p2 * inverse[1, 1]
    wp.atomic_add(gradient, s, corners[1], g1)
    wp.atomic_add(gradient, s, corners[2], g2)
    wp.atomic_add(gradient, s, corners[0], -g1 - g2)


@wp.kernel
def stretch_kernel(
    x: wp.array2d(dtype=wp.vec3),
    rest_row: wp.array(dtype=wp.int32),
    faces: wp.array2d(dtype=wp.int32),
    rest_inverse: wp.array2d(dtype=wp.mat22),
    rest_area: wp.array2d(dtype=wp.float32),
    mu: wp.float32,
    lam: wp.float32,
    energy: wp.array2d(dtype=wp.float32),
    gradient: wp.array2d(dtype=wp.vec3),
    normals: wp.array2d(dtype=wp.vec3),
):
    """StVK membrane of one face of one sample (Barbic and James 2005); also adds the face normal to its corners."""
    s, t = wp.tid()
    a, b, c = faces[t, 0], faces[t, 1], faces[t, 2]
    x0 = x[s, a]
    d1 = x[s, b] - x0
    d2 = x[s, c] - x0
    inverse = rest_inverse[rest_row[s], t]
    area = rest_area[rest_row[s], t]
    f1, f2 = deformation_columns(d1, d2, inverse)
    e11 = 0.5 * (wp.dot(f1, f1) - 1.0)
    e22 = 0.5 * (wp.dot(f2, f2) - 1.0)
    e12 = 0.5 * wp.dot(f1, f2)
    trace = e11 + e22
    energy[s, t] = area * (mu * (e11 * e11 + e22 * e22 + 2.0 * e12 * e12) + 0.5 * lam * trace * trace)
    stress = wp.vec3(2.0 * mu * e11 + lam * trace, 2.0 * mu * e22 + lam * trace, 2.0 * mu * e12)
    add_membrane_forces(gradient, s, wp.vec3i(a, b, c), f1, f2, stress, inverse, area)
    normal = wp.cross(d1, d2)
    wp.atomic_add(normals, s, a, normal)
    wp.atomic_add(normals, s, b, normal)
    wp.atomic_add(normals, s, c, normal)


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
    """Dihedral bending of one hinge of one sample: k (theta - rest)^2 (Grinspun et al. 2003)."""
    s, t = wp.tid()
    i0, i1, i2, i3 = hinges[t, 0], hinges[t, 1], hinges[t, 2], hinges[t, 3]
    x0, x1, x2, x3 = x[s, i0], x[s, i1], x[s, i2], x[s, i3]
    edge = x1 - x0
    length = wp.max(wp.length(edge), 1.0e-9)
    na = wp.cross(edge, x2 - x0)
    nb = wp.cross(x3 - x0, edge)
    na2 = wp.max(wp.dot(na, na), 1.0e-16)
    nb2 = wp.max(wp.dot(nb, nb), 1.0e-16)
    angle = wp.atan2(wp.dot(wp.cross(na, nb), edge) / length, wp.dot(na, nb)) - rest_angle[rest_row[s], t]
    angle = angle - 2.0 * wp.pi * wp.round(angle / (2.0 * wp.pi))
    k = stiffness[rest_row[s], t] * stiffer[s]
    energy[s, t] = k * angle * angle
    slope = 2.0 * k * angle
    ga = na * (slope / na2)
    gb = nb * (slope / nb2)
    wp.atomic_add(gradient, s, i2, ga * -length)
    wp.atomic_add(gradient, s, i3, gb * -length)
    wp.atomic_add(gradient, s, i0, (ga * wp.dot(x2 - x1, edge) + gb * wp.dot(x3 - x1, edge)) / -length)
    wp.atomic_add(gradient, s, i1, (ga * wp.dot(x2 - x0, edge) + gb * wp.dot(x3 - x0, edge)) / length)


@wp.kernel
def collision_kernel(
    x: wp.array2d(dtype=wp.vec3),
    body: wp.uint64,
    body_offset: wp.array(dtype=wp.vec3),
    rest_row: wp.array(dtype=wp.int32),
    vertex_area: wp.array2d(dtype=wp.float32),
    stiffness: wp.array(dtype=wp.float32),
    contact_offset: wp.float32,
    linear_beyond: wp.float32,
    reach: wp.float32,
    face_bone: wp.array(dtype=wp.int32),
    worn: wp.array2d(dtype=wp.bool),
    other_limb: wp.array2d(dtype=wp.bool),
    own_face: wp.array(dtype=wp.int32),
    leads_back: wp.bool,
    normals: wp.array2d(dtype=wp.vec3),
    energy: wp.array2d(dtype=wp.float32),
    gradient: wp.array2d(dtype=wp.vec3),
    signed_distance: wp.array2d(dtype=wp.float32),
    at_worn_part: wp.array2d(dtype=wp.bool),
):
    """Squared depth below the contact offset, to the exact closest point of the posed body; linear when deeper.

    own_face: face of the body that each vertex lies on. A bone of `other_limb` presses cloth only towards it, so that
    cloth which came out on the limb's far side is not held there; leads_back: a vertex lost inside the body is pushed
    before it.
    """
    s, v = wp.tid()
    point = x[s, v] + body_offset[s]
    hit = wp.mesh_query_point_sign_normal(body, point, reach)
    energy[s, v] = 0.0
    signed_distance[s, v] = reach
    at_worn_part[s, v] = False
    if hit.result:
        closest = wp.mesh_eval_position(body, hit.face, hit.u, hit.v)
        away = point - closest
        gap = wp.length(away)
        distance = hit.sign * gap
        signed_distance[s, v] = distance
        part = face_bone[hit.face % face_bone.shape[0]]
        mine = worn[v, part]
        at_worn_part[s, v] = mine
        depth = contact_offset - distance
        if depth > 0.0:
            outward = wp.mesh_eval_face_normal(body, hit.face)
            own = s * face_bone.shape[0] + own_face[v]
            own_centre = wp.mesh_eval_position(body, own, 1.0 / 3.0, 1.0 / 3.0)
            if depth < DEEP or (mine and wp.dot(outward, normals[s, v]) >= 0.0):
                if other_limb[v, part] and wp.dot(outward, own_centre - closest) <= 0.0:
                    return
                if gap > 1.0e-6:
                    outward = away * (hit.sign / gap)
                k = stiffness[0] * vertex_area[rest_row[s], v]
                bounded = wp.min(depth, linear_beyond)
                energy[s, v] = k * bounded * (2.0 * depth - bounded)
                wp.atomic_add(gradient, s, v, outward * (-2.0 * k * bounded))
            elif leads_back:
                own_outward = wp.mesh_eval_face_normal(body, own)
                behind = contact_offset - wp.dot(point - own_centre, own_outward)
                if behind > 0.0:
                    k = stiffness[0] * vertex_area[rest_row[s], v]
                    bounded = wp.min(behind, LED_BACK_BEYOND)
                    energy[s, v] = k * bounded * (2.0 * behind - bounded)
                    wp.atomic_add(gradient, s, v, own_outward * (-2.0 * k * bounded))


@wp.kernel
def band_kernel(
    x: wp.array2d(dtype=wp.vec3),
    body_points: wp.array(dtype=wp.vec3),
    body_offset: wp.array(dtype=wp.vec3),
    vertices_per_body: wp.int32,
    band: wp.array(dtype=wp.int32),
    place: wp.array(dtype=wp.int32),
    limit: wp.array(dtype=wp.float32),
    rest_row: wp.array(dtype=wp.int32),
    vertex_area: wp.array2d(dtype=wp.float32),
    energy: wp.array2d(dtype=wp.float32),
    gradient: wp.array2d(dtype=wp.vec3),
):
    """Squared distance of a band vertex beyond its limit from the body vertex where it is worn."""
    s, k = wp.tid()
    v = band[k]
    away = x[s, v] + body_offset[s] - body_points[s * vertices_per_body + place[k]]
    distance = wp.length(away)
    beyond = distance - limit[k]
    energy[s, k] = 0.0
    if beyond > 0.0:
        stiffness = BAND_STIFFNESS * vertex_area[rest_row[s], v]
        energy[s, k] = stiffness * beyond * beyond
        wp.atomic_add(gradient, s, v, away * (2.0 * stiffness * beyond / distance))


@wp.kernel
def gravity_kernel(
    x: wp.array2d(dtype=wp.vec3),
    direction: wp.array(dtype=wp.vec3),
    rest_row: wp.array(dtype=wp.int32),
    weight: wp.array2d(dtype=wp.float32),
    energy: wp.array2d(dtype=wp.float32),
    gradient: wp.array2d(dtype=wp.vec3),
):
    """Potential energy, height measured against the gravity direction from the root."""
    s, v = wp.tid()
    pull = weight[rest_row[s], v]
    energy[s, v] = -pull * wp.dot(x[s, v], direction[s])
    wp.atomic_add(gradient, s, v, direction[s] * -pull)
