"""Self-contact: squared depth of vertices below an offset from other cloth of the same garment.

Each vertex looks among the places that it may meet (`TouchingPlaces`) for the nearest one, and there for the closest
point of the faces around. It keeps to its side of that face, whose corners are pushed back. The second derivative
treats the face as a plane, and is positive semidefinite. Which corners it couples changes with the drape: blocks hold
what is on the diagonal, and the remainder is added to products.
"""

from collections.abc import Callable

import numpy as np
import torch

from physkin_training.contact.surface_queries import closest_on_face
from physkin_training.contact.touching_places import MEETS_WITHIN, OVER, TouchingPlaces
from physkin_training.energies.energy import Blocks, Cloth, Drapes, Energy, Rest, view
from physkin_training.quiet_warp import wp

__all__ = ["DEEPEST", "OFFSET", "SOFTNESS", "SelfContact"]

wp.set_module_options({"enable_backward": False})

OFFSET = 0.002
"""[m] that vertices keep from faces. Edges of 15 mm cut 0.6 mm off cloth that turns as sharply as a sleeve does, on
both sides; the remainder is the cloth's own thickness."""
DEEPEST = 0.025
"""[m] A vertex farther through is of another layer. No step of a solver brings it that far through at once."""
SOFTNESS = 0.1
"""Stiffness relative to that of contact with the body. Where skin presses limbs into each other, cloth cannot stay
outside of both it and other cloth; then skin counts. Cloth upon cloth weighs 2 N/m2, which sinks in 3 um."""


@wp.struct
class Touching:
    """`TouchingPlaces`, and corners (f, 3) of the faces."""

    candidate: wp.array2d(dtype=wp.int32)
    side: wp.array2d(dtype=wp.int8)
    place: wp.array(dtype=wp.int32)
    around_start: wp.array(dtype=wp.int32)
    around: wp.array(dtype=wp.int32)
    faces: wp.array2d(dtype=wp.int32)


@wp.struct
class Contacts:
    """Of each vertex (B, n): itself and the corners of the face that it touches, how much each counts in its height
    over the face, along `out`, and the second derivative of its energy by that height, 0 where it touches none."""

    ends: wp.array2d(dtype=wp.vec4i)
    share: wp.array2d(dtype=wp.vec4)
    out: wp.array2d(dtype=wp.vec3)
    curvature: wp.array2d(dtype=wp.float32)


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
    chosen = wp.int32(-1)
    nearest = MEETS_WITHIN * MEETS_WITHIN
    for k in range(touching.candidate.shape[1]):
        candidate = touching.candidate[v, k]
        if candidate < 0:
            break
        squared = wp.length_sq(drapes.x[s, touching.place[candidate]] - point)
        if squared < nearest:
            nearest = squared
            chosen = k
    if chosen < 0:
        return
    place = touching.candidate[v, chosen]
    side = wp.int32(touching.side[v, chosen])
    nearest = MEETS_WITHIN * MEETS_WITHIN
    ends = wp.vec4i(-1, -1, -1, -1)
    share = wp.vec3(0.0, 0.0, 0.0)
    gap = wp.vec3(0.0, 0.0, 0.0)
    normal = wp.vec3(0.0, 0.0, 0.0)
    for k in range(touching.around_start[place], touching.around_start[place + 1]):
        face = touching.around[k]
        a, b, c = touching.faces[face, 0], touching.faces[face, 1], touching.faces[face, 2]
        corners = wp.matrix_from_rows(drapes.x[s, a], drapes.x[s, b], drapes.x[s, c])
        closest = closest_on_face(point, corners[0], corners[1], corners[2])
        away = point - wp.transpose(corners) * closest
        if wp.length_sq(away) < nearest:
            nearest = wp.length_sq(away)
            ends = wp.vec4i(v, a, b, c)
            share = closest
            gap = away
            normal = wp.normalize(wp.cross(corners[1] - corners[0], corners[2] - corners[0]))
    alike = wp.dot(normal, drapes.normals[s, v])
    if ends[0] < 0 or (wp.abs(side) == 2 and alike >= 0.0) or (wp.abs(side) == 3 and alike <= 0.0):
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
    if depth <= 0.0 or depth > DEEPEST:
        return
    k_area = stiffness[0] * rest.vertex_area[rest.row[s], v]
    bounded = wp.min(depth, linear_beyond)
    energy[s, v] = k_area * bounded * (2.0 * depth - bounded)
    shares = wp.vec4(1.0, -share[0], -share[1], -share[2])
    for i in range(4):
        wp.atomic_add(drapes.gradient, s, ends[i], -2.0 * k_area * bounded * shares[i] * out)
    if depth < linear_beyond:
        contacts.ends[s, v] = ends
        contacts.share[s, v] = shares
        contacts.out[s, v] = out
        contacts.curvature[s, v] = 2.0 * k_area


@wp.kernel
def diagonal_kernel(contacts: Contacts, blocks: Blocks):
    """Blocks of a vertex and of the face's corners with themselves."""
    s, v = wp.tid()
    curvature = contacts.curvature[s, v]
    if not blocks.active[s] or curvature == 0.0:
        return
    block = curvature * wp.outer(contacts.out[s, v], contacts.out[s, v])
    for i in range(4):
        share = contacts.share[s, v][i]
        wp.atomic_add(blocks.all, s, blocks.slots[contacts.ends[s, v][i], 0], share * share * block)


@wp.kernel
def coupling_kernel(
    contacts: Contacts,
    active: wp.array(dtype=wp.bool),
    x: wp.array2d(dtype=wp.vec3),
    product: wp.array2d(dtype=wp.vec3),
):
    """The blocks beside the diagonal times a vector."""
    s, v = wp.tid()
    if not active[s] or contacts.curvature[s, v] == 0.0:
        return
    ends = contacts.ends[s, v]
    share = contacts.share[s, v]
    out = contacts.out[s, v]
    height = wp.float32(0.0)
    for i in range(4):
        height += share[i] * wp.dot(out, x[s, ends[i]])
    for i in range(4):
        others = height - share[i] * wp.dot(out, x[s, ends[i]])
        wp.atomic_add(product, s, ends[i], contacts.curvature[s, v] * share[i] * others * out)


class SelfContact(Energy):
    """Nothing without places that may touch. stiffness: (1,) [J/m4], may be changed in place."""

    name = "self_contact"

    def __init__(self, cloth: Cloth, places: TouchingPlaces | None, *, linear_beyond: float) -> None:
        n = 0 if places is None else len(cloth.garment.vertices)
        super().__init__(cloth, np.arange(n)[:, None])
        self.stiffness = torch.full((1,), SOFTNESS * cloth.material.contact_stiffness, device=cloth.device)
        self.linear_beyond, self._stiffness, self._touching = linear_beyond, wp.from_torch(self.stiffness), Touching()
        for name, table in {} if places is None else (vars(places) | {"faces": cloth.garment.faces}).items():
            setattr(self._touching, name, cloth.array(table, wp.int8 if name == "side" else wp.int32))
        self.state, self._contacts = self._none_yet(n)
        self._kept, self._kept_contacts = self._none_yet(n)

    def _none_yet(self, n: int) -> tuple[tuple[torch.Tensor, ...], Contacts]:
        zeros, contacts = self.cloth.zeros, Contacts()
        ends, share, out, curvature = zeros(n, 4, dtype=torch.int32), zeros(n, 4), zeros(n, 3), zeros(n)
        contacts.ends, contacts.share = view(ends, wp.vec4i), view(share, wp.vec4)
        contacts.out, contacts.curvature = view(out), wp.from_torch(curvature)
        return (ends, share, out, curvature), contacts

    def evaluate(self, drapes: Drapes) -> None:
        given = self._rest, drapes, self._stiffness, self.linear_beyond, self._touching
        self._launch(self_contact_kernel, *given, self._energy, self._contacts)

    def add_second_derivative(self, drapes: Drapes, blocks: Blocks) -> None:
        self._launch(diagonal_kernel, self._contacts, blocks)
        active = wp.to_torch(blocks.active)
        for kept, now in zip(self._kept, self.state):
            kept.copy_(torch.where(active.view(-1, *[1] * (now.dim() - 1)), now, kept))

    def add_coupling(self, active: wp.array, x: wp.array, product: wp.array) -> None:
        self._launch(coupling_kernel, self._kept_contacts, active, x, product)

    def forecast(self) -> Callable[[torch.Tensor], torch.Tensor]:
        """As of `Collision.forecast`, where the force grows on."""
        values, (ends, share, out, curvature) = self.values.clone(), (tensor.clone() for tensor in self.state)
        slope, sample = (2 * curvature * values).sqrt(), torch.arange(len(ends), device=ends.device)[:, None, None]

        def after(step: torch.Tensor) -> torch.Tensor:
            along = torch.einsum("bvk,bvki,bvi->bv", share, step[sample, ends.long()], out)
            return values + (0.5 * curvature * along - slope) * along

        return after
