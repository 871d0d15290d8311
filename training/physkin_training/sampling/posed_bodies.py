"""Bodies of a batch: forward kinematics, skinning and one Warp mesh over all of them for contact queries.

The mesh's bounding-volume hierarchy is built once, at the canonical pose, with the samples laid out on a grid; each
step moves the points and refits it. Parts of a body move together, so the tree stays good and building is saved.

Dimensions: `B` samples, `b` bones, `d` degrees of freedom, `V` body vertices, `K` influences. Metres, root frame.
"""

from __future__ import annotations

import math

import numpy as np
import torch

from physkin_core.avatar.avatar import Avatar
from physkin_core.avatar.body_model import BodyModel
from physkin_core.model.garment import vertex_normals
from physkin_core.rig.linear_blend_skinning import dense_weights
from physkin_core.rig.rig import Rig
from physkin_training.quiet_warp import wp

__all__ = ["BodySet", "PosedBodies", "posed_avatar"]

GRID_SPACING = 3.0
"""Distance [m] between neighbouring samples' roots in the shared mesh."""

wp.set_module_options({"enable_backward": False})


@wp.kernel
def forward_kinematics_kernel(
    positions: wp.array2d(dtype=wp.float32),
    heads: wp.array2d(dtype=wp.vec3),
    parents: wp.array(dtype=wp.int32),
    dof_start: wp.array(dtype=wp.int32),
    dof_order: wp.array(dtype=wp.int32),
    dof_axes: wp.array(dtype=wp.vec3),
    dof_rest: wp.array(dtype=wp.float32),
    rotations: wp.array2d(dtype=wp.mat33),
    translations: wp.array2d(dtype=wp.vec3),
):
    """Twin of `physkin_core.rig.rig.forward_kinematics` for one sample."""
    s = wp.tid()
    for bone in range(parents.shape[0]):
        local = wp.identity(n=3, dtype=wp.float32)
        for k in range(dof_start[bone], dof_start[bone + 1]):
            dof = dof_order[k]
            turn = wp.quat_from_axis_angle(dof_axes[dof], positions[s, dof] - dof_rest[dof])
            local = local * wp.quat_to_matrix(turn)
        head = heads[s, bone]
        parent = parents[bone]
        posed = head
        rotation = local
        if parent >= 0:
            posed = rotations[s, parent] * head + translations[s, parent]
            rotation = rotations[s, parent] * local
        rotations[s, bone] = rotation
        translations[s, bone] = posed - rotation * head


@wp.kernel
def pose_body_kernel(
    body_vertices: wp.array2d(dtype=wp.vec3),
    body_index: wp.array(dtype=wp.int64),
    influence_bones: wp.array2d(dtype=wp.int32),
    influence_weights: wp.array2d(dtype=wp.float32),
    rotations: wp.array2d(dtype=wp.mat33),
    translations: wp.array2d(dtype=wp.vec3),
    offset: wp.array(dtype=wp.vec3),
    points: wp.array(dtype=wp.vec3),
):
    """Linear blend skinning of one body vertex of one sample, displaced to its place on the grid."""
    s, v = wp.tid()
    rest = body_vertices[wp.int32(body_index[s]), v]
    posed = wp.vec3(0.0, 0.0, 0.0)
    for k in range(influence_bones.shape[1]):
        weight = influence_weights[v, k]
        if weight > 0.0:
            bone = influence_bones[v, k]
            posed += weight * (rotations[s, bone] * rest + translations[s, bone])
    points[s * body_vertices.shape[1] + v] = posed + offset[s]


class BodySet:
    """Bodies of the compact body model on one device: surfaces, bones and surface points for the hyper modulator.

    coefficients: (S, c) shape coefficients, NumPy. swelling: (S, b) [m] how far each bone's part of the skin lies
    outside the body, as where another garment is worn under this one; it changes smoothly from part to part. Default
    nowhere. `vertices` (S, V, 3), `heads`, `tails` (S, b, 3) [m], canonical pose.
    """

    def __init__(
        self, model: BodyModel, coefficients: np.ndarray, device: torch.device, *, swelling: np.ndarray | None = None
    ) -> None:
        def tensor(array: np.ndarray) -> torch.Tensor:
            return torch.as_tensor(np.ascontiguousarray(array), device=device, dtype=torch.float32)

        self.coefficients = coefficients
        shape = tensor(coefficients)
        self.vertices = tensor(model.mean_vertices) + torch.einsum(
            "sc,cvi->svi", shape, tensor(model.vertex_components)
        )
        if swelling is not None and swelling.any():
            swollen = np.flatnonzero(swelling.any(axis=1))
            parts = dense_weights(model.influence_bones, model.influence_weights, model.rig.bone_count)
            for row in swollen:
                outward = vertex_normals(self.vertices[row].cpu().numpy(), model.faces)
                self.vertices[row] += tensor((parts @ swelling[row])[:, None] * outward)
        bones = tensor(model.mean_bones) + torch.einsum("sc,cbhi->sbhi", shape, tensor(model.bone_components))
        self.heads, self.tails = bones[:, :, 0].contiguous(), bones[:, :, 1].contiguous()
        self.faces = torch.as_tensor(model.faces, device=device, dtype=torch.int64)
        corners = self.vertices[:, self.faces]
        cross = torch.linalg.cross(corners[:, :, 1] - corners[:, :, 0], corners[:, :, 2] - corners[:, :, 0])
        area = torch.linalg.norm(cross, dim=-1)
        self._face_normals = cross / area.clamp_min(1e-20)[..., None]
        self._cumulative_area = (area.double().cumsum(dim=1) / area.double().sum(dim=1, keepdim=True)).float()

    def __len__(self) -> int:
        return len(self.vertices)

    def sample_points(self, bodies: torch.Tensor, count: int) -> tuple[torch.Tensor, torch.Tensor]:
        """Area-uniform surface points and face normals (S', count, 3) of the bodies indexed by (S',)."""
        device = self.vertices.device
        strata = (torch.arange(count, device=device) + torch.rand(len(bodies), count, device=device)) / count
        face = torch.searchsorted(self._cumulative_area[bodies], strata).clamp_max(len(self.faces) - 1)
        root = torch.rand(len(bodies), count, 1, device=device).sqrt()
        second = torch.rand(len(bodies), count, 1, device=device)
        corners = self.vertices[bodies[:, None, None], self.faces[face]]
        points = (1 - root) * corners[:, :, 0] + root * ((1 - second) * corners[:, :, 1] + second * corners[:, :, 2])
        return points, self._face_normals[bodies[:, None], face]


class PosedBodies:
    """Poses a fixed number of samples, each a body of a `BodySet`, and keeps their joint contact mesh.

    faces: (f, 3) of the body that the contact mesh has, default all. `offset` (B, 3) [m]: where each sample's root
    is in `mesh`, which is that of the last `pose`.
    """

    def __init__(self, model: BodyModel, bodies: BodySet, samples: int, *, faces: np.ndarray | None = None) -> None:
        wp.init()
        torch_device = bodies.vertices.device
        self.device = wp.device_from_torch(torch_device)
        self.bodies = bodies
        rig: Rig = model.rig
        order = np.argsort(rig.dof_bones, kind="stable")
        start = np.searchsorted(rig.dof_bones[order], np.arange(rig.bone_count + 1))
        self._parents = wp.array(rig.parents, dtype=wp.int32, device=self.device)
        self._dof_start = wp.array(start.astype(np.int32), dtype=wp.int32, device=self.device)
        self._dof_order = wp.array(order.astype(np.int32), dtype=wp.int32, device=self.device)
        self._dof_axes = wp.array(rig.dof_axes.astype(np.float32), dtype=wp.vec3, device=self.device)
        self._dof_rest = wp.array(rig.rest.astype(np.float32), dtype=wp.float32, device=self.device)
        self._influence_bones = wp.array(model.influence_bones, dtype=wp.int32, device=self.device)
        self._influence_weights = wp.array(model.influence_weights, dtype=wp.float32, device=self.device)
        self._rotations = torch.zeros(samples, rig.bone_count, 3, 3, device=torch_device)
        self._translations = torch.zeros(samples, rig.bone_count, 3, device=torch_device)
        side = math.ceil(samples ** (1 / 3))
        cell = torch.arange(samples, device=torch_device)
        grid = torch.stack([cell % side, cell // side % side, cell // side**2], dim=1)
        self.offset = (grid - (side - 1) / 2).float() * GRID_SPACING
        vertex_count = bodies.vertices.shape[1]
        first_vertex = (torch.arange(samples, device=torch_device) * vertex_count)[:, None, None]
        own_faces = bodies.faces if faces is None else torch.as_tensor(faces, device=torch_device, dtype=torch.int64)
        faces_of_all = (own_faces[None] + first_vertex).reshape(-1).to(torch.int32)
        points = (bodies.vertices[:1] + self.offset[:, None]).reshape(-1, 3)
        self.mesh = wp.Mesh(
            points=wp.array(points.cpu().numpy(), dtype=wp.vec3, device=self.device),
            indices=wp.array(faces_of_all.cpu().numpy(), dtype=wp.int32, device=self.device),
        )

    @property
    def vertices(self) -> torch.Tensor:
        """(B, V, 3) [m] surfaces of the bodies posed last, in their root frames."""
        return wp.to_torch(self.mesh.points).view(len(self.offset), -1, 3) - self.offset[:, None]

    def bone_transforms(self, joint_positions: torch.Tensor, body_index: torch.Tensor) -> torch.Tensor:
        """Bone transforms (B, b, 3, 4) at joint_positions (B, d) [rad] of bodies (B,) int64; the mesh stays.

        Raises ValueError when there are not as many of both as samples: kernels would write beyond their arrays.
        """
        samples, given = len(self.offset), (len(joint_positions), len(body_index))
        if given != (samples, samples):
            got = f"got {given[0]} and {given[1]}"
            raise ValueError(f"joint positions and bodies must be {samples} each, one a sample; {got}")
        heads = self.bodies.heads[body_index]
        rotations = wp.from_torch(self._rotations, dtype=wp.mat33)
        translations = wp.from_torch(self._translations, dtype=wp.vec3)
        wp.launch(
            forward_kinematics_kernel,
            dim=len(joint_positions),
            inputs=[
                wp.from_torch(joint_positions.contiguous()),
                wp.from_torch(heads, dtype=wp.vec3),
                self._parents,
                self._dof_start,
                self._dof_order,
                self._dof_axes,
                self._dof_rest,
            ],
            outputs=[rotations, translations],
            device=self.device,
        )
        return torch.cat([self._rotations, self._translations[..., None]], dim=-1)

    def pose(self, joint_positions: torch.Tensor, body_index: torch.Tensor | None = None) -> torch.Tensor:
        """Pose the samples, all of body 0 by default, and refit the contact mesh; otherwise as `bone_transforms`."""
        if body_index is None:
            body_index = torch.zeros(len(joint_positions), dtype=torch.int64, device=self.offset.device)
        transforms = self.bone_transforms(joint_positions, body_index)
        wp.launch(
            pose_body_kernel,
            dim=(len(joint_positions), self.bodies.vertices.shape[1]),
            inputs=[
                wp.from_torch(self.bodies.vertices, dtype=wp.vec3),
                wp.from_torch(body_index),
                self._influence_bones,
                self._influence_weights,
                wp.from_torch(self._rotations, dtype=wp.mat33),
                wp.from_torch(self._translations, dtype=wp.vec3),
                wp.from_torch(self.offset, dtype=wp.vec3),
            ],
            outputs=[self.mesh.points],
            device=self.device,
        )
        self.mesh.refit()
        return transforms


def posed_avatar(avatar: Avatar, rig: Rig, samples: int, device: torch.device) -> PosedBodies:
    """One avatar, `samples` times: body 0 of a set of one."""
    none = np.zeros((1, 0), dtype=np.float32)
    model = BodyModel(
        rig=rig,
        faces=avatar.faces,
        influence_bones=avatar.influence_bones,
        influence_weights=avatar.influence_weights,
        mean_vertices=avatar.vertices,
        vertex_components=np.zeros((0, *avatar.vertices.shape)),
        mean_bones=np.stack([avatar.bone_heads, avatar.bone_tails], axis=1),
        bone_components=np.zeros((0, len(avatar.bone_heads), 2, 3)),
        garment_body=none[0],
        train_bodies=none,
        held_out_bodies=none,
        held_out_children=none,
        held_out_elders=none,
    )
    return PosedBodies(model, BodySet(model, none, device), samples)
