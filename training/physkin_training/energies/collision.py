"""Collision: squared depth below the contact offset, to the exact closest point of the posed body.

For each vertex in contact the kernel keeps the direction out of the body, and the first and second derivative of its
energy by depth; everything else follows from them. The second derivative treats the closest surface as a plane, and is
positive semidefinite.
"""

from collections.abc import Callable

import numpy as np
import torch
from scipy.spatial import cKDTree

from physkin_training.contact.wearing import Wearing
from physkin_training.energies.energy import Blocks, Cloth, Drapes, Energy, Rest, view
from physkin_training.quiet_warp import wp

__all__ = ["LED_BACK_BEYOND", "Collision"]

wp.set_module_options({"enable_backward": False})

DEEP = 0.01
"""Beyond this depth [m] below the contact offset a hit counts only if the vertex is worn on that part of the body, and
body and cloth face the same direction. Otherwise it is another limb, or the wrong side of this one."""

ACROSS = 0.01
"""A vertex this far [m] beyond the middle of the limb that its sleeve goes around came through it, and is lost, too."""

LED_BACK_BEYOND = 0.001
"""Depth [m] behind its own place on the body up to which the force grows that leads a lost vertex back."""


@wp.func
def centre_of(body: wp.uint64, face: int):
    return wp.mesh_eval_position(body, face, 1.0 / 3.0, 1.0 / 3.0)


@wp.kernel
def collision_kernel(
    rest: Rest,
    drapes: Drapes,
    order: wp.array(dtype=wp.int32),
    stiffness: wp.array(dtype=wp.float32),
    contact_offset: wp.float32,
    linear_beyond: wp.float32,
    reach: wp.float32,
    face_bone: wp.array(dtype=wp.int32),
    worn: wp.array2d(dtype=wp.bool),
    other_limb: wp.array2d(dtype=wp.bool),
    own_face: wp.array(dtype=wp.int32),
    far_face: wp.array(dtype=wp.int32),
    inside_out: wp.array(dtype=wp.bool),
    leads_back: wp.bool,
    energy: wp.array2d(dtype=wp.float32),
    slope: wp.array2d(dtype=wp.float32),
    curvature: wp.array2d(dtype=wp.float32),
    out_of_body: wp.array2d(dtype=wp.vec3),
    signed_distance: wp.array2d(dtype=wp.float32),
    at_worn_part: wp.array2d(dtype=wp.bool),
):
    """One vertex of one sample. order: of vertices, so that threads beside each other look in the same places.
    own_face: face of the body that each vertex lies on, so that no closest point is farther, or -1. far_face: the one
    across the limb, or -1. inside_out: its normal points into the body. A bone of `other_limb` presses cloth only
    towards it, so that cloth which came out on the limb's far side is not held there; leads_back: a vertex lost inside
    the body, or beyond its limb, is pushed before it."""
    s, k = wp.tid()
    v = order[k]
    body = drapes.body
    point = drapes.x[s, v] + drapes.offset[s]
    own = s * face_bone.shape[0] + own_face[v]
    own_centre = wp.vec3(0.0, 0.0, 0.0)
    within = reach
    if own_face[v] >= 0:
        own_centre = centre_of(body, own)
        within = wp.min(reach, 1.001 * wp.length(point - own_centre) + 1.0e-5)
    lost = False
    if leads_back and far_face[v] >= 0:
        far_centre = centre_of(body, s * face_bone.shape[0] + far_face[v])
        across = own_centre - far_centre
        lost = wp.dot(point - 0.5 * (own_centre + far_centre), across) < -ACROSS * wp.length(across)
    hit = wp.mesh_query_point_sign_normal(body, point, within)
    energy[s, v] = 0.0
    slope[s, v] = 0.0
    curvature[s, v] = 0.0
    out_of_body[s, v] = wp.vec3(0.0, 0.0, 0.0)
    signed_distance[s, v] = reach
    at_worn_part[s, v] = False
    depth = 0.0
    outward = wp.vec3(0.0, 0.0, 0.0)
    limit = linear_beyond
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
            alike = wp.dot(outward, drapes.normals[s, v])
            if inside_out[v]:
                alike = -alike
            if depth < DEEP or (mine and alike >= 0.0):
                if other_limb[v, part] and wp.dot(outward, own_centre - closest) <= 0.0:
                    depth = 0.0
                if gap > 1.0e-6:
                    outward = away * (hit.sign / gap)
            else:
                depth = 0.0
                lost = leads_back
    if lost:
        limit = LED_BACK_BEYOND
        outward = wp.mesh_eval_face_normal(body, own)
        depth = contact_offset - wp.dot(point - own_centre, outward)
    if depth <= 0.0:
        return
    k_area = stiffness[0] * rest.vertex_area[rest.row[s], v]
    bounded = wp.min(depth, limit)
    energy[s, v] = k_area * bounded * (2.0 * depth - bounded)
    slope[s, v] = 2.0 * k_area * bounded
    if depth < limit:
        curvature[s, v] = 2.0 * k_area
    out_of_body[s, v] = outward
    wp.atomic_add(drapes.gradient, s, v, outward * (-2.0 * k_area * bounded))


class Collision(Energy):
    """Of the body's parts that `wearing` counts; without it all count. See `PhysicsLosses`.

    stiffness: (1,) [J/m4], and reach [m], farthest distance at which the body is looked for, may be changed between
    evaluations. Of the last one: signed_distance (B, n) [m] to the body, capped at the reach, and at_worn_part (B, n)
    bool, whether the closest part is one that the vertex is worn on.
    """

    name = "collision"

    def __init__(
        self, cloth: Cloth, wearing: "Wearing | None", *, reach: float, linear_beyond: float, leads_back: bool
    ) -> None:
        n = len(cloth.garment.vertices)
        super().__init__(cloth, np.arange(n)[:, None])
        self.reach, self.linear_beyond = reach, linear_beyond
        self.stiffness = torch.full((1,), cloth.material.contact_stiffness, device=cloth.device)
        everywhere = np.ones((n, 1), dtype=bool)
        self._wearing = (
            cloth.array(np.zeros(1) if wearing is None else wearing.face_bone),
            cloth.array(everywhere if wearing is None else wearing.worn, wp.bool),
            cloth.array(~everywhere if wearing is None else wearing.other_limb, wp.bool),
            cloth.array(np.full(n, -1) if wearing is None else wearing.own_face),
            cloth.array(np.full(n, -1) if wearing is None else wearing.far_face),
            cloth.array(np.zeros(n) if wearing is None else wearing.inside_out, wp.bool),
            leads_back and wearing is not None,
        )
        self._stiffness = wp.from_torch(self.stiffness)
        self._order = cloth.array(cKDTree(cloth.garment.vertices).indices)
        self.signed_distance, self.at_worn_part = cloth.zeros(n), cloth.zeros(n, dtype=torch.bool)
        self.state = slope, curvature, out_of_body = cloth.zeros(n), cloth.zeros(n), cloth.zeros(n, 3)
        self._derivatives = wp.from_torch(slope), wp.from_torch(curvature), view(out_of_body)
        self._where = wp.from_torch(self.signed_distance), wp.from_torch(self.at_worn_part)

    def evaluate(self, drapes: Drapes) -> None:
        limits = self.cloth.material.contact_offset, self.linear_beyond, self.reach
        given = self._rest, drapes, self._order, self._stiffness, *limits, *self._wearing
        self._launch(collision_kernel, *given, self._energy, *self._derivatives, *self._where)

    def add_second_derivative(self, drapes: Drapes, blocks: Blocks) -> None:
        self._add_vertex_blocks(blocks, None, *self._derivatives[1:])

    def forecast(self) -> Callable[[torch.Tensor], torch.Tensor]:
        """Of a step (B, n, 3) [m] from where this was evaluated last: the energies (B, n) [J] that both derivatives
        foresee after it."""
        values, slope, curvature, out_of_body = (tensor.clone() for tensor in (self.values, *self.state))

        def after(step: torch.Tensor) -> torch.Tensor:
            along = (out_of_body * step).sum(dim=2)
            return values + (0.5 * curvature * along - slope) * along

        return after
