"""Self-contact: squared depth of vertices below an offset from other cloth of the same garment.

Each vertex looks among the places that it may meet (`TouchingPlaces`) for the one nearest to it, and there for the
closest point of the faces around. It keeps to its side of that face, and what pushes it pushes the face's corners back.
The second derivative treats the face as a plane, and is positive semidefinite; which corners it couples changes with
the drape, so that what is beside the diagonal is multiplied without blocks.
"""

from collections.abc import Callable

import numpy as np
import torch

from physkin_training.contact.touching_places import MEETS_WITHIN, TouchingPlaces
from physkin_training.energies.energy import Blocks, Cloth, Drapes, Energy, Rest, view
from physkin_training.quiet_warp import wp

__all__ = ["DEEPEST", "OFFSET", "SelfContact"]

wp.set_module_options({"enable_backward": False})

OFFSET = 0.002
"""[m] that vertices keep from faces. Edges and faces of 15 mm cut 0.6 mm off cloth that turns as sharply as a sleeve
does, on both sides; the remainder is the cloth's own thickness."""
DEEPEST, DEEPEST_IN_FOLD = 0.03, 0.015
"""[m] A vertex farther through is of another sheet, which lies behind this one; and of another fold. Folds of a few
centimetres are no deeper."""
IN_FOLD_WITHIN = 0.03
"""[m] from a vertex to a place with which it may be in one fold: as `MEETS_WITHIN`, for such a depth."""
SOFTNESS = 0.1
"""Stiffness relative to that of contact with the body. Where skin presses limbs into each other, cloth cannot keep
outside of both it and other cloth; then skin counts. Cloth upon cloth weighs 2 N/m2, which sinks in 2 um so."""
OVER = 0.7
"""Cosine between a face's normal and the direction to a vertex above which the vertex is over the face: one that is
beside an edge of the cloth does not touch it."""


@wp.struct
class Touching:
    """`TouchingPlaces`, and the faces' corners (f, 3)."""

    candidate: wp.array2d(dtype=wp.int32)
    side: wp.array2d(dtype=wp.int8)
    middle: wp.array2d(dtype=wp.int32)
    place: wp.array(dtype=wp.int32)
    around_start: wp.array(dtype=wp.int32)
    around: wp.array(dtype=wp.int32)
    faces: wp.array2d(dtype=wp.int32)


@wp.struct
class Contacts:
    """Of each vertex the face that it touches (B, n), the barycentric coordinates there (B, n), where the vertex is
    pushed (B, n), and the second derivative of its energy by depth (B, n), 0 where it touches nothing."""

    face: wp.array2d(dtype=wp.int32)
    share: wp.array2d(dtype=wp.vec3)
    out: wp.array2d(dtype=wp.vec3)
    curvature: wp.array2d(dtype=wp.float32)


@wp.func
def along_edge(point: wp.vec3, a: wp.vec3, b: wp.vec3) -> wp.float32:
    """Where on an edge the point closest to another one is, from 0 to 1."""
    edge = b - a
    return wp.clamp(wp.dot(point - a, edge) / wp.max(wp.dot(edge, edge), 1.0e-12), 0.0, 1.0)


@wp.func
def closest_on(point: wp.vec3, a: wp.vec3, b: wp.vec3, c: wp.vec3) -> wp.vec3:
    """Barycentric coordinates of the face's point that is closest to another one."""
    normal = wp.cross(b - a, c - a)
    size = wp.max(wp.dot(normal, normal), 1.0e-20)
    second = wp.dot(wp.cross(point - a, c - a), normal) / size
    third = wp.dot(wp.cross(b - a, point - a), normal) / size
    if second >= 0.0 and third >= 0.0 and second + third <= 1.0:
        return wp.vec3(1.0 - second - third, second, third)
    t = along_edge(point, a, b)
    best = wp.vec3(1.0 - t, t, 0.0)
    nearest = wp.length_sq(a + t * (b - a) - point)
    t = along_edge(point, b, c)
    if wp.length_sq(b + t * (c - b) - point) < nearest:
        best = wp.vec3(0.0, 1.0 - t, t)
        nearest = wp.length_sq(b + t * (c - b) - point)
    t = along_edge(point, c, a)
    if wp.length_sq(c + t * (a - c) - point) < nearest:
        best = wp.vec3(t, 0.0, 1.0 - t)
    return best


@wp.kernel
def self_contact_kernel(
    rest: Rest,
    drapes: Drapes,
    stiffness: wp.array(dtype=wp.float32),
    linear_beyond: wp.float32,
    touching: Touching,
    energy: wp.array2d(dtype=wp.float32),
    contacts: Contacts,
):
    """One vertex of one sample."""
    s, v = wp.tid()
    energy[s, v] = 0.0
    contacts.curvature[s, v] = 0.0
    point = drapes.x[s, v]
    place = wp.int32(-1)
    side = wp.int32(0)
    middle = wp.int32(-1)
    nearest = MEETS_WITHIN * MEETS_WITHIN
    for k in range(touching.candidate.shape[1]):
        candidate = touching.candidate[v, k]
        if candidate < 0:
            break
        squared = wp.length_sq(drapes.x[s, touching.place[candidate]] - point)
        if squared < nearest:
            nearest = squared
            place = candidate
            side = wp.int32(touching.side[v, k])
            middle = touching.middle[v, k]
    if place < 0 or (middle >= 0 and nearest > IN_FOLD_WITHIN * IN_FOLD_WITHIN):
        return
    nearest = MEETS_WITHIN * MEETS_WITHIN
    face = wp.int32(-1)
    share = wp.vec3(0.0, 0.0, 0.0)
    gap = wp.vec3(0.0, 0.0, 0.0)
    for k in range(touching.around_start[place], touching.around_start[place + 1]):
        other = touching.around[k]
        a = drapes.x[s, touching.faces[other, 0]]
        b = drapes.x[s, touching.faces[other, 1]]
        c = drapes.x[s, touching.faces[other, 2]]
        closest = closest_on(point, a, b, c)
        away = point - (closest[0] * a + closest[1] * b + closest[2] * c)
        if wp.length_sq(away) < nearest:
            nearest = wp.length_sq(away)
            face = other
            share = closest
            gap = away
    if face < 0:
        return
    corners = wp.vec3i(touching.faces[face, 0], touching.faces[face, 1], touching.faces[face, 2])
    first = drapes.x[s, corners[0]]
    normal = wp.normalize(wp.cross(drapes.x[s, corners[1]] - first, drapes.x[s, corners[2]] - first))
    alike = wp.dot(normal, drapes.normals[s, v])
    if side == 0:
        side = 2
        if wp.dot(0.5 * (point + first) - drapes.x[s, middle], drapes.normals[s, middle]) < 0.0:
            side = -2
    if (wp.abs(side) == 2 and alike >= 0.0) or (wp.abs(side) == 3 and alike <= 0.0):
        return
    out = normal * wp.sign(wp.float32(side))
    distance = wp.length(gap)
    if distance > 1.0e-6:
        over = wp.dot(gap, out)
        if wp.abs(over) < OVER * distance:
            return
        distance = distance * wp.sign(over)
        out = gap / distance
    depth = OFFSET - distance
    deepest = wp.where(middle >= 0, DEEPEST_IN_FOLD, DEEPEST)
    if depth <= 0.0 or depth > deepest:
        return
    k_area = SOFTNESS * stiffness[0] * rest.vertex_area[rest.row[s], v]
    bounded = wp.min(depth, linear_beyond)
    energy[s, v] = k_area * bounded * (2.0 * depth - bounded)
    force = out * (2.0 * k_area * bounded)
    wp.atomic_add(drapes.gradient, s, v, -force)
    for corner in range(3):
        wp.atomic_add(drapes.gradient, s, corners[corner], share[corner] * force)
    if depth < linear_beyond:
        contacts.curvature[s, v] = 2.0 * k_area
        contacts.face[s, v] = face
        contacts.share[s, v] = share
        contacts.out[s, v] = out


@wp.kernel
def diagonal_kernel(touching: Touching, contacts: Contacts, kept: Contacts, blocks: Blocks):
    """Blocks of the vertex and the face's corners with themselves, and a copy of the contact for what couples them."""
    s, v = wp.tid()
    if not blocks.active[s]:
        return
    curvature = contacts.curvature[s, v]
    kept.curvature[s, v] = curvature
    if curvature == 0.0:
        return
    face = contacts.face[s, v]
    share = contacts.share[s, v]
    out = contacts.out[s, v]
    kept.face[s, v] = face
    kept.share[s, v] = share
    kept.out[s, v] = out
    block = curvature * wp.outer(out, out)
    wp.atomic_add(blocks.all, s, blocks.slots[v, 0], block)
    for corner in range(3):
        slot = blocks.slots[touching.faces[face, corner], 0]
        wp.atomic_add(blocks.all, s, slot, share[corner] * share[corner] * block)


@wp.kernel
def coupling_kernel(
    touching: Touching,
    kept: Contacts,
    active: wp.array(dtype=wp.bool),
    x: wp.array2d(dtype=wp.vec3),
    product: wp.array2d(dtype=wp.vec3),
):
    """The blocks beside the diagonal times a vector."""
    s, v = wp.tid()
    curvature = kept.curvature[s, v]
    if not active[s] or curvature == 0.0:
        return
    face = kept.face[s, v]
    share = kept.share[s, v]
    out = kept.out[s, v]
    nearer = wp.dot(out, x[s, v])
    for corner in range(3):
        nearer -= share[corner] * wp.dot(out, x[s, touching.faces[face, corner]])
    wp.atomic_add(product, s, v, curvature * (nearer - wp.dot(out, x[s, v])) * out)
    for corner in range(3):
        at = touching.faces[face, corner]
        others = nearer + share[corner] * wp.dot(out, x[s, at])
        wp.atomic_add(product, s, at, -curvature * share[corner] * others * out)


class SelfContact(Energy):
    """Nothing without places that may touch. stiffness: (1,) [J/m4], that of contact with the body."""

    name = "self_contact"

    def __init__(
        self, cloth: Cloth, places: TouchingPlaces | None, *, stiffness: torch.Tensor, linear_beyond: float
    ) -> None:
        n = 0 if places is None else len(cloth.garment.vertices)
        super().__init__(cloth, np.arange(n)[:, None])
        self.linear_beyond, self._stiffness = linear_beyond, wp.from_torch(stiffness)
        self._touching = Touching()
        if places is not None:
            self._touching.candidate = cloth.array(places.candidate)
            self._touching.side = cloth.array(places.side, wp.int8)
            self._touching.middle = cloth.array(places.middle)
            self._touching.place = cloth.array(places.place)
            self._touching.around_start = cloth.array(places.around_start)
            self._touching.around = cloth.array(places.around)
            self._touching.faces = cloth.array(cloth.garment.faces)
        self.state, self._contacts = self._none_yet(n)
        self._kept_state, self._kept = self._none_yet(n)

    def _none_yet(self, n: int) -> tuple[tuple[torch.Tensor, ...], Contacts]:
        zeros, contacts = self.cloth.zeros, Contacts()
        tensors = face, share, out, curvature = zeros(n, dtype=torch.int32), zeros(n, 3), zeros(n, 3), zeros(n)
        contacts.face, contacts.curvature = wp.from_torch(face), wp.from_torch(curvature)
        contacts.share, contacts.out = view(share), view(out)
        return tensors, contacts

    def evaluate(self, drapes: Drapes) -> None:
        given = self._rest, drapes, self._stiffness, self.linear_beyond, self._touching
        self._launch(self_contact_kernel, *given, self._energy, self._contacts)

    def add_second_derivative(self, drapes: Drapes, blocks: Blocks) -> None:
        self._launch(diagonal_kernel, self._touching, self._contacts, self._kept, blocks)

    def forecast(self) -> Callable[[torch.Tensor], torch.Tensor]:
        """As of `Collision.forecast`, where the force grows on."""
        values, (face, share, out, curvature) = self.values.clone(), (tensor.clone() for tensor in self.state)
        slope = (2 * curvature * values).sqrt()
        corners = torch.as_tensor(self.cloth.garment.faces, dtype=torch.int64, device=face.device)[face.long()]
        sample = torch.arange(len(face), device=face.device)[:, None, None]

        def after(step: torch.Tensor) -> torch.Tensor:
            along = (out * (step - (share[..., None] * step[sample, corners]).sum(dim=2))).sum(dim=2)
            return values + (0.5 * curvature * along - slope) * along

        return after

    def add_coupling(self, active: wp.array, x: wp.array, product: wp.array) -> None:
        self._launch(coupling_kernel, self._touching, self._kept, active, x, product)
