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
from physkin_core.look.surfaces import ROUGHNESS, Picture, Surface, linear, split_at_seams, surfaces_of
from physkin_core.mesh.look import Look
from physkin_core.model.garment import vertex_normals
from physkin_core.motion.motion import Motion
from physkin_core.outfit.outfit import Outfit
from physkin_core.picture import BODY_COLOUR, layer_colours
from physkin_core.rig.rig import Rig
from physkin_core.runtime.bound_garment import BoundGarment

__all__ = ["write_gltf_motion"]


def write_gltf_motion(
    path: Path, outfit: Outfit, motion: Motion, *, looks: Sequence[Look | None] | None = None
) -> None:
    """Write avatar and garments in motion as one .glb, the root where the motion has it.

    outfit: of models `for_engines`; vertices that it hides are left out. Order between layers and tucks move vertices,
    not garment nodes, and are not in the file. looks: of the body's faces that are shown, as of `avatar_look`, and
    of each garment, as of `garment_looks`; default a colour each. Raises OSError when it cannot be written.
    """
    rig, bones, nodes = outfit.rig, [], []
    outfit.reset()
    for positions, time, root_now in zip(motion.positions_for(rig), motion.times, motion.root):
        outfit.drape(positions, time=time, root=root_now)
        bones.append(outfit.bone_transforms(positions))
        nodes.append(outfit.node_transforms())
    looks = looks or [None] * (1 + len(outfit.layers))
    scene = _Scene(motion.times)
    root = scene.add_root(translation=motion.root_position[:, None], rotation=motion.root_orientation[:, None])
    scene.add_avatar(outfit.body_to_draw, rig, np.array(bones), outfit.faces_to_draw, root, looks[0])
    colours = layer_colours(len(outfit.layers))
    for layer, transforms, colour, look in zip(outfit.layers, zip(*nodes), colours, looks[1:]):
        scene.add_garment(layer.name, layer.given, np.array(transforms), root, colour, look)
    write_glb(path, scene.finished())


class _Scene:
    """A glTF document with one animation while it grows. Arrays come in our root frame. times: (T,) [s]."""

    def __init__(self, times: np.ndarray) -> None:
        self.builder = GltfBuilder({"generator": "PhySkin"})
        self._nodes, self._meshes, self._skins, self._materials, self._channels, self._samplers = ([] for _ in range(6))
        self._roots: list[int] = []
        self._pictures: dict[Picture, int] = {}
        self.builder.document |= {
            "scene": 0,
            "scenes": [{"nodes": self._roots}],
            "nodes": self._nodes,
            "meshes": self._meshes,
            "skins": self._skins,
            "materials": self._materials,
            "animations": [{"name": "motion", "channels": self._channels, "samplers": self._samplers}],
        }
        self._times = self.builder.add_accessor(times.astype(np.float32))
        span = {"min": [float(np.float32(times[0]))], "max": [float(np.float32(times[-1]))]}
        self.builder.document["accessors"][self._times] |= span

    def add_root(self, **paths: np.ndarray) -> int:
        """What all else hangs on. paths: translation (T, 1, 3) [m] and rotation (T, 1, 4)."""
        self._roots.append(len(self._nodes))
        self._add_joints(["root"], parent=None, **paths)
        return self._roots[-1]

    def add_avatar(
        self, avatar: Avatar, rig: Rig, bones: np.ndarray, shown: np.ndarray, root: int, look: Look | None
    ) -> None:
        """The body on its skeleton. bones: (T, b, 3, 4) canonical to posed; shown: (F,) bool of its faces; look: of
        these."""
        heads = avatar.bone_heads.astype(np.float64)
        turned = bones[..., :3].astype(np.float64)
        posed = np.einsum("tbij,bj->tbi", turned, heads) + bones[..., 3]
        first = len(self._nodes)
        for bone, (name, parent) in enumerate(zip(rig.bone_names, rig.parents)):
            rotation, place, rest = turned[:, bone], posed[:, bone], heads[bone]
            if parent >= 0:
                rest = rest - heads[parent]
                back = np.swapaxes(turned[:, parent], 1, 2)
                rotation, place = back @ rotation, np.einsum("tij,tj->ti", back, place - posed[:, parent])
            self._add_joints(
                [name],
                parent=first + parent if parent >= 0 else root,
                rest=rest[None],
                translation=place[:, None],
                rotation=Rotation.from_matrix(rotation).as_quat()[:, None],
            )
        joints = list(range(first, first + len(heads)))
        vertices = avatar.vertices, vertex_normals(avatar.vertices, avatar.faces)
        influences = strongest_influences(avatar.influence_bones, avatar.influence_weights)
        self._add_mesh("body", vertices, influences, avatar.faces[shown], BODY_COLOUR, look, joints, heads)

    def add_garment(
        self,
        name: str,
        bound: BoundGarment,
        transforms: np.ndarray,
        root: int,
        colour: tuple[float, float, float],
        look: Look | None,
    ) -> None:
        """A garment on its garment nodes. transforms: (T, m, 3, 4). colour: sRGB, of what has no material."""
        chains = as_joint_chains(transforms)
        names = [f"{name}_{node}" for node in range(transforms.shape[1])]
        moved = {"translation": chains.translation, "rotation": chains.rotation, "scale": chains.scale}
        outer = self._add_joints(names, parent=root, rest=bound.node_rest, **moved)
        inner = []
        for k, (each, joint) in enumerate(zip(names, outer)):
            turn = chains.inner_rotation[:, [k]]
            inner += self._add_joints([f"{each}_inner"], parent=joint, rest=np.zeros((1, 3)), rotation=turn)
        vertices = bound.vertices, bound.normals
        influences = strongest_influences(bound.influence_nodes, bound.influence_weights)
        self._add_mesh(name, vertices, influences, bound.faces, colour, look, inner, bound.node_rest)

    def finished(self) -> GltfBuilder:
        """The document, whole."""
        if self._pictures:
            images = [
                {"name": each.name, "mimeType": each.kind, "bufferView": view} for each, view in self._pictures.items()
            ]
            textures = [{"source": image} for image in range(len(images))]
            self.builder.document |= {"images": images, "textures": textures}
        return self.builder

    def _add_joints(
        self, names: Sequence[str], *, parent: int | None, rest: np.ndarray | None = None, **paths: np.ndarray
    ) -> list[int]:
        """Nodes with arrays (T, j, width) of what moves them. rest: (j, 3) where in their parent they are, unturned,
        when nothing does; default where they are in the first frame.

        Blender skins a mesh to the joints at rest and from there to the motion. That is the same as at once only if
        they rest where the mesh was bound.
        """
        first = len(self._nodes)
        for joint, name in enumerate(names):
            node: dict = {"name": name}
            if rest is not None:
                node["translation"] = _in_gltf_frame("translation", rest[[joint]])[0].tolist()
            for path, values in paths.items():
                moved = _in_gltf_frame(path, values[:, joint])
                if rest is None:
                    node[path] = moved[0].tolist()
                self._channels.append(
                    {"sampler": len(self._samplers), "target": {"node": len(self._nodes), "path": path}}
                )
                self._samplers.append({"input": self._times, "output": self.builder.add_accessor(moved)})
            if parent is not None:
                self._nodes[parent].setdefault("children", []).append(len(self._nodes))
            self._nodes.append(node)
        return list(range(first, len(self._nodes)))

    def _add_mesh(
        self,
        name: str,
        vertices: tuple[np.ndarray, np.ndarray],
        influences: tuple[np.ndarray, np.ndarray],
        faces: np.ndarray,
        colour: tuple[float, float, float],
        look: Look | None,
        joints: Sequence[int],
        rest: np.ndarray,
    ) -> None:
        """A mesh skinned by joints that are at `rest` (j, 3) when it is as given. vertices: positions (v, 3) and
        normals (v, 3). influences: as of `strongest_influences`."""
        surfaces = surfaces_of(look, name, linear(colour), len(faces))
        add, attributes = self.builder.add_accessor, {}
        if look is not None:
            own, places, faces = split_at_seams(look, faces)
            vertices, influences = (tuple(each[own] for each in pair) for pair in (vertices, influences))
            attributes["TEXCOORD_0"] = add((places * [1, -1] + [0, 1]).astype(np.float32))
        positions, normals = vertices
        normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
        attributes |= {
            "POSITION": add((positions @ FROM_ROOT_FRAME.T).astype(np.float32)),
            "NORMAL": add((normals @ FROM_ROOT_FRAME.T).astype(np.float32)),
            "JOINTS_0": add(influences[0]),
            "WEIGHTS_0": add(influences[1], normalized=True),
        }
        primitives = []
        for surface in surfaces:
            indices = self.builder.add_accessor(faces[surface.faces].astype(np.uint32).reshape(-1))
            material = self._add_material(surface)
            primitives.append({"attributes": attributes, "indices": indices, "material": material})
        bind = np.tile(np.eye(4), (len(rest), 1, 1))
        bind[:, :3, 3] = -rest @ FROM_ROOT_FRAME.T
        inverse = self.builder.add_accessor(bind.transpose(0, 2, 1).reshape(-1, 16).astype(np.float32))
        self._meshes.append({"name": name, "primitives": primitives})
        self._skins.append({"joints": joints, "inverseBindMatrices": inverse})
        self._roots.append(len(self._nodes))
        self._nodes.append({"name": name, "mesh": len(self._meshes) - 1, "skin": len(self._skins) - 1})

    def _add_material(self, surface: Surface) -> int:
        """Its index."""
        shading = {"baseColorFactor": [*surface.colour, 1.0], "metallicFactor": 0.0, "roughnessFactor": ROUGHNESS}
        if surface.picture is not None:
            shading["baseColorTexture"] = {"index": self._texture_of(surface.picture)}
        self._materials.append({"name": surface.name, "pbrMetallicRoughness": shading, "doubleSided": True})
        return len(self._materials) - 1

    def _texture_of(self, picture: Picture) -> int:
        """Its index; a picture is in the file once."""
        if picture not in self._pictures:
            self._pictures[picture] = self.builder.add_view(np.frombuffer(picture.content, dtype=np.uint8))
        return list(self._pictures).index(picture)


def _in_gltf_frame(path: str, values: np.ndarray) -> np.ndarray:
    """Translations, rotations or scales (T, width) of the root frame in glTF's, float32."""
    if path == "rotation":
        turned = np.concatenate([values[:, :3] @ FROM_ROOT_FRAME.T, values[:, 3:]], axis=1)
        return (turned / np.linalg.norm(turned, axis=1, keepdims=True)).astype(np.float32)
    return (values @ FROM_ROOT_FRAME.T).astype(np.float32)
