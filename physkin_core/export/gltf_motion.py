"""A draped motion as glTF 2.0: the avatar on its skeleton, garments on skins whose joints are their garment nodes.

A garment node is affine, a glTF joint is not: each is a chain of two joints (`affine_joints`). Engines take 4
influences a vertex, which models learn beside their own skinning weights (`GarmentModel.for_engines`).
Dimensions: `T` frames, `b` bones, `m` garment nodes, `v` vertices given of a garment.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from physkin_core.avatar.avatar import Avatar
from physkin_core.export.affine_joints import as_joint_chains
from physkin_core.export.gltf_builder import FROM_ROOT_FRAME, GltfBuilder, strongest_influences, write_glb
from physkin_core.model.garment import vertex_normals
from physkin_core.motion.motion import Motion
from physkin_core.outfit.outfit import Outfit
from physkin_core.picture import BODY_COLOUR, layer_colours
from physkin_core.rig.rig import Rig
from physkin_core.runtime.bound_garment import BoundGarment

__all__ = ["write_gltf_motion"]

ROUGHNESS = 0.9


def write_gltf_motion(path: Path, outfit: Outfit, motion: Motion) -> None:
    """Write avatar and garments in motion as one .glb, the root where the motion has it.

    outfit: of models `for_engines`; vertices that it hides are left out. Order between layers and tucks move vertices,
    not garment nodes, and are not in the file. Raises OSError when it cannot be written.
    """
    rig, drapers = outfit.models[0].rig, outfit.drapers
    bones, nodes = [], [[] for _ in drapers]
    for draper, sway in zip(drapers, outfit.sways):
        draper.sway = sway
    for positions, time, root_now in zip(motion.positions_for(rig), motion.times, motion.root):
        bones.append(outfit.bone_transforms(positions))
        for draper, transforms in zip(drapers, nodes):
            draper.drape(positions, time=time, root=root_now)
            transforms.append(draper.node_transforms())
    scene = _Scene(motion.times)
    root = scene.add_node("root", translation=motion.root_position[:, None], rotation=motion.root_orientation[:, None])
    scene.roots.append(root)
    scene.add_avatar(outfit.avatar, rig, np.array(bones), outfit.body_mask, root)
    colours = layer_colours(len(drapers))
    for model, bound, transforms, colour in zip(outfit.models, outfit.bounds, nodes, colours):
        scene.add_garment(model.name, bound, np.array(transforms), colour, root)
    write_glb(path, scene.finished())


class _Scene:
    """A glTF document with one animation while it grows. Arrays come in our root frame. times: (T,) [s]."""

    def __init__(self, times: np.ndarray) -> None:
        self.builder = GltfBuilder({"generator": "PhySkin"})
        self.nodes: list[dict] = []
        self.roots: list[int] = []
        self._meshes: list[dict] = []
        self._skins: list[dict] = []
        self._materials: list[dict] = []
        self._channels: list[dict] = []
        self._samplers: list[dict] = []
        self._times = self.builder.add_accessor(times.astype(np.float32))
        span = {"min": [float(np.float32(times[0]))], "max": [float(np.float32(times[-1]))]}
        self.builder.document["accessors"][self._times] |= span

    def add_node(self, name: str, *, parent: int | None = None, **paths: np.ndarray) -> int:
        """One node; paths: translation (T, 1, 3) [m], rotation (T, 1, 4) or scale (T, 1, 3), by name."""
        return self._add_joints([name], parent=parent, **paths)[0]

    def add_avatar(self, avatar: Avatar, rig: Rig, bones: np.ndarray, hidden: np.ndarray, root: int) -> None:
        """The body on its skeleton. bones: (T, b, 3, 4) canonical to posed; hidden: (F,) faces that cloth covers."""
        heads = avatar.bone_heads.astype(np.float64)
        turned = bones[..., :3].astype(np.float64)
        posed = np.einsum("tbij,bj->tbi", turned, heads) + bones[..., 3]
        first = len(self.nodes)
        for bone, (name, parent) in enumerate(zip(rig.bone_names, rig.parents)):
            rotation, place = turned[:, bone], posed[:, bone]
            if parent >= 0:
                back = np.swapaxes(turned[:, parent], 1, 2)
                rotation, place = back @ rotation, np.einsum("tij,tj->ti", back, place - posed[:, parent])
            self.add_node(
                name,
                parent=first + parent if parent >= 0 else root,
                translation=place[:, None],
                rotation=Rotation.from_matrix(rotation).as_quat()[:, None],
            )
        joints = list(range(first, first + len(heads)))
        normals = vertex_normals(avatar.vertices, avatar.faces)
        influences = avatar.influence_bones, avatar.influence_weights
        self._add_skinned(
            "body", avatar.vertices, normals, avatar.faces[~hidden], influences, joints, heads, BODY_COLOUR
        )

    def add_garment(
        self, name: str, bound: BoundGarment, transforms: np.ndarray, colour: tuple[float, float, float], root: int
    ) -> None:
        """A garment on its garment nodes. transforms: (T, m, 3, 4)."""
        chains = as_joint_chains(transforms)
        names = [f"{name}_{node}" for node in range(transforms.shape[1])]
        outer = self._add_joints(
            names, parent=root, translation=chains.translation, rotation=chains.rotation, scale=chains.scale
        )
        inner = [
            self.add_node(f"{each}_inner", parent=joint, rotation=chains.inner_rotation[:, [k]])
            for k, (each, joint) in enumerate(zip(names, outer))
        ]
        influences = bound.influence_nodes, bound.influence_weights
        self._add_skinned(name, bound.vertices, bound.normals, bound.faces, influences, inner, bound.node_rest, colour)

    def finished(self) -> GltfBuilder:
        """The document, whole."""
        self.builder.document |= {
            "scene": 0,
            "scenes": [{"nodes": self.roots}],
            "nodes": self.nodes,
            "meshes": self._meshes,
            "skins": self._skins,
            "materials": self._materials,
            "animations": [{"name": "motion", "channels": self._channels, "samplers": self._samplers}],
        }
        return self.builder

    def _add_joints(self, names: Sequence[str], *, parent: int | None, **paths: np.ndarray) -> list[int]:
        """Nodes with arrays (T, j, width) of what moves them; the first frame is where they are at rest."""
        first = len(self.nodes)
        for joint, name in enumerate(names):
            node: dict = {"name": name}
            for path, values in paths.items():
                moved = _in_gltf_frame(path, values[:, joint])
                node[path] = moved[0].tolist()
                self._channels.append(
                    {"sampler": len(self._samplers), "target": {"node": len(self.nodes), "path": path}}
                )
                self._samplers.append({"input": self._times, "output": self.builder.add_accessor(moved)})
            if parent is not None:
                self.nodes[parent].setdefault("children", []).append(len(self.nodes))
            self.nodes.append(node)
        return list(range(first, len(self.nodes)))

    def _add_skinned(self, name, vertices, normals, faces, influences, joints, rest, colour) -> None:
        """A mesh (v, 3) skinned by joints that are at `rest` (j, 3) when it is as given."""
        add = self.builder.add_accessor
        bind = np.tile(np.eye(4), (len(rest), 1, 1))
        bind[:, :3, 3] = -rest @ FROM_ROOT_FRAME.T
        stored, weights = strongest_influences(*influences)
        normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
        attributes = {
            "POSITION": add((vertices @ FROM_ROOT_FRAME.T).astype(np.float32)),
            "NORMAL": add((normals @ FROM_ROOT_FRAME.T).astype(np.float32)),
            "JOINTS_0": add(stored),
            "WEIGHTS_0": add(weights, normalized=True),
        }
        indices = add(faces.astype(np.uint32).reshape(-1))
        inverse = add(bind.transpose(0, 2, 1).reshape(-1, 16).astype(np.float32))
        linear = [float(channel) ** 2.2 for channel in colour]
        surface = {"baseColorFactor": [*linear, 1.0], "metallicFactor": 0.0, "roughnessFactor": ROUGHNESS}
        self._materials.append({"name": name, "pbrMetallicRoughness": surface, "doubleSided": True})
        primitive = {"attributes": attributes, "indices": indices, "material": len(self._materials) - 1}
        self._meshes.append({"name": name, "primitives": [primitive]})
        self._skins.append({"joints": joints, "inverseBindMatrices": inverse})
        self.roots.append(len(self.nodes))
        self.nodes.append({"name": name, "mesh": len(self._meshes) - 1, "skin": len(self._skins) - 1})


def _in_gltf_frame(path: str, values: np.ndarray) -> np.ndarray:
    """Translations, rotations or scales (T, width) of the root frame in glTF's, float32."""
    if path == "rotation":
        turned = np.concatenate([values[:, :3] @ FROM_ROOT_FRAME.T, values[:, 3:]], axis=1)
        return (turned / np.linalg.norm(turned, axis=1, keepdims=True)).astype(np.float32)
    return (values @ FROM_ROOT_FRAME.T).astype(np.float32)
