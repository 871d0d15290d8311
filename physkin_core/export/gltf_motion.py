"""A draped motion as glTF 2.0: the avatar on its skeleton, garments on skins whose joints are their garment nodes.

A garment node is affine, a glTF joint is not: each is a chain of two joints (`affine_joints`). Engines take 4
influences a vertex, which models learn beside their own skinning weights (`GarmentModel.for_engines`). What moves
vertices besides, detail and the order of layers, is in morph targets (`morph_targets`).
Dimensions: `T` frames, `b` bones, `m` garment nodes, `v` vertices of a mesh, `j` joints.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from physkin_core.avatar.avatar import Avatar
from physkin_core.export.affine_joints import as_joint_chains
from physkin_core.export.draped_clip import DrapedGarment, drape_clip
from physkin_core.export.gltf_scene import GltfScene, in_gltf_frame
from physkin_core.export.morph_targets import MorphTargets
from physkin_core.formats.gltf_builder import FROM_ROOT_FRAME, GltfBuilder, strongest_influences, write_glb
from physkin_core.look.cloth_look import cloth_colours
from physkin_core.mesh.finishing import Finish
from physkin_core.mesh.look import Look
from physkin_core.mesh.surfaces import parts_of
from physkin_core.model.skinning import unit
from physkin_core.motion.motion import Motion
from physkin_core.outfit.outfit import Outfit
from physkin_core.pictures.picture import BODY_COLOUR
from physkin_core.rig.rig import Rig

__all__ = ["AnimatedScene", "not_shown", "write_gltf_motion"]

TOO_FAR = 0.005
"""[m] off from where the order of layers has a vertex: less is hardly ever seen."""


def write_gltf_motion(path: Path, outfit: Outfit, motion: Motion, *, looks: Sequence[Look | None]) -> list[str]:
    """Write avatar and garments in motion as one .glb, the root where the motion has it. Returns what it cannot show, a
    sentence each.

    outfit: as of `drape_clip`; what no frame shows is left out. looks: of all faces of
    `outfit.body_to_draw`, as of `avatar_look`, and of each garment, as of `garment_looks`; None for a colour. What
    finishes a garment, stitches and hems, are meshes on its skin.
    Raises OSError when it cannot be written.
    """
    clip = drape_clip(outfit, motion)
    scene = AnimatedScene([({"name": motion.name or path.stem, "channels": [], "samplers": []}, motion.times)])
    root = scene.add_root(translation=motion.root_position[:, None], rotation=motion.root_orientation[:, None])
    scene.add_avatar(outfit.body_to_draw, outfit.rig, clip.bones, clip.body_shown, root, looks[0])
    colours = cloth_colours(outfit.garments)
    for garment, layer, colour, look in zip(clip.garments, outfit.layers, colours, looks[1:]):
        if garment.shown.any():
            own = None if look is None else look.of_faces(garment.shown, layer.faces)
            rest = garment.given.node_rest
            scene.add_garment(garment, [root] * len(rest), colour, own, rest=rest)
    write_glb(path, scene.builder)
    return [warning for garment in clip.garments for warning in not_shown(garment)]


def not_shown(garment: DrapedGarment) -> list[str]:
    """What a .glb cannot show of a garment, a sentence if anything."""
    if not garment.shown.any():
        return [f"{garment.name} is not in the file: it is covered in all frames"]
    lacking = garment.lacking.max(axis=1, initial=0)
    if garment.morphs.turns is not None and lacking.any():
        average = garment.lacking.sum() / (len(lacking) * len(garment.given.vertices))
        return [
            f"{garment.name} is {1000 * average:.2f} mm off on average, {1000 * lacking.max():.1f} mm at most, because "
            f"{len(garment.morphs.targets)} morph targets hold its folds; a .usdc is exact"
        ]
    if lacking.max() < TOO_FAR:
        return []
    return [
        f"{garment.name} is up to {1000 * lacking.max():.0f} mm off in {np.sum(lacking >= TOO_FAR)} of {len(lacking)} "
        "frames, where morph targets cannot keep the order of layers: what lies beneath may show there; a .usdc has it "
        "exactly"
    ]


class AnimatedScene(GltfScene):
    """A scene with animations. takes: each, new ones or those of builder's document, and its times [s]; their frames
    follow one another in arrays, after `still` ones that belong to none."""

    def __init__(
        self, takes: Sequence[tuple[dict, np.ndarray]], builder: GltfBuilder | None = None, *, still: int = 0
    ) -> None:
        super().__init__(builder)
        self._takes: list[tuple[dict, int, slice]] = []
        for animation, times in takes:
            accessor = self.builder.add_accessor(times.astype(np.float32))
            span = {"min": [float(np.float32(times[0]))], "max": [float(np.float32(times[-1]))]}
            self.builder.document["accessors"][accessor] |= span
            self._takes.append((animation, accessor, slice(still, still + len(times))))
            still += len(times)
        if builder is None:
            self.builder.document["animations"] = [animation for animation, _ in takes]

    def add_root(self, **paths: np.ndarray) -> int:
        """What all else hangs on. paths: translation (T, 1, 3) [m] and rotation (T, 1, 4)."""
        self.roots.append(len(self.nodes))
        self._add_joints(["root"], parents=None, **paths)
        return self.roots[-1]

    def add_avatar(
        self, avatar: Avatar, rig: Rig, bones: np.ndarray, shown: np.ndarray, root: int, look: Look | None
    ) -> None:
        """The body on its skeleton. bones: (T, b, 3, 4) canonical to posed; shown: (F,) bool of its faces."""
        heads = avatar.bone_heads.astype(np.float64)
        turned = bones[..., :3].astype(np.float64)
        posed = np.einsum("tbij,bj->tbi", turned, heads) + bones[..., 3]
        first = len(self.nodes)
        for bone, (name, parent) in enumerate(zip(rig.bone_names, rig.parents)):
            rotation, place, rest = turned[:, bone], posed[:, bone], heads[bone]
            if parent >= 0:
                rest = rest - heads[parent]
                back = np.swapaxes(turned[:, parent], 1, 2)
                rotation, place = back @ rotation, np.einsum("tij,tj->ti", back, place - posed[:, parent])
            self._add_joints(
                [name],
                parents=[first + parent if parent >= 0 else root],
                rest=rest[None],
                translation=place[:, None],
                rotation=Rotation.from_matrix(rotation).as_quat()[:, None],
            )
        own = None if look is None else look.of_faces(shown, avatar.faces)
        (part,) = parts_of(own, "body", BODY_COLOUR, avatar.faces[shown])
        self.add_body(avatar, part, skin=self.add_skin("body", range(first, first + len(heads)), heads))

    def add_garment(
        self,
        garment: DrapedGarment,
        parents: Sequence[int],
        colour: tuple[float, float, float],
        look: Look | None,
        rest: np.ndarray | None = None,
    ) -> None:
        """A garment on its garment nodes. parents: (m,) nodes that these hang on. colour: sRGB, of what has no
        material. rest: (m, 3) as of `_add_joints`."""
        name, bound = garment.name, garment.given
        chains = as_joint_chains(garment.node_transforms)
        names = [f"{name}_{node}" for node in range(len(bound.node_rest))]
        moved = {"translation": chains.translation, "rotation": chains.rotation, "scale": chains.scale}
        outer = self._add_joints(names, parents=parents, rest=rest, **moved)
        names, rest = [f"{each}_inner" for each in names], None if rest is None else np.zeros_like(rest)
        inner = self._add_joints(names, parents=outer, rest=rest, rotation=chains.inner_rotation)
        skin = self.add_skin(name, inner, bound.node_rest)
        joints, weights = strongest_influences(bound.influence_nodes, bound.influence_weights)
        cloud = np.concatenate([bound.vertices, unit(bound.normals)], axis=1)
        morphs = garment.morphs if len(garment.morphs.targets) else None
        for part in parts_of(look, name, colour, bound.faces):
            vertices, changes = slice(None), morphs
            if part.finish is not None:
                vertices, changes = part.finish.vertices, None if morphs is None else _finished(morphs, part.finish)
            influences = {"JOINTS_0": joints[vertices], "WEIGHTS_0": weights[vertices]}
            self.add_mesh(part, part.on(cloud), attributes=influences, morphs=changes, skin=skin)
            if changes is not None:
                self._animate(len(self.nodes) - 1, "weights", changes.weights.astype(np.float32))

    def _add_joints(
        self,
        names: Sequence[str],
        *,
        parents: Sequence[int] | None,
        rest: np.ndarray | None = None,
        **paths: np.ndarray,
    ) -> list[int]:
        """Nodes with arrays (T, j, width) of what moves them. parents: (j,) or none. rest: (j, 3) where in their parent
        they are, unturned, when nothing does; default where they are in the first frame.

        Blender skins a mesh to the joints at rest and from there to the motion. That is the same as at once only if
        they rest where the mesh was bound.
        """
        first = len(self.nodes)
        for joint, name in enumerate(names):
            node: dict = {"name": name}
            if rest is not None:
                node["translation"] = _moved_in_gltf_frame("translation", rest[[joint]])[0].tolist()
            for path, values in paths.items():
                moved = _moved_in_gltf_frame(path, values[:, joint])
                if rest is None:
                    node[path] = moved[0].tolist()
                self._animate(len(self.nodes), path, moved)
            if parents is not None:
                self.nodes[parents[joint]].setdefault("children", []).append(len(self.nodes))
            self.nodes.append(node)
        return list(range(first, len(self.nodes)))

    def _animate(self, node: int, path: str, values: np.ndarray) -> None:
        """values: (T, width) float32."""
        for animation, times, frames in self._takes:
            output = self.builder.add_accessor(values[frames].reshape(-1) if path == "weights" else values[frames])
            channel = {"sampler": len(animation["samplers"]), "target": {"node": node, "path": path}}
            animation["channels"].append(channel)
            animation["samplers"].append({"input": times, "output": output})


def _finished(morphs: MorphTargets, finish: Finish) -> MorphTargets:
    """The morph targets of a finish on a garment. What is turned up looks the other way."""
    found = morphs.of_vertices(finish.vertices)
    if found.turns is None:
        return found
    return replace(found, turns=found.turns * np.where(finish.above < 0, -1.0, 1.0)[found.moved, None])


def _moved_in_gltf_frame(path: str, values: np.ndarray) -> np.ndarray:
    """Translations, rotations or scales (T, width) of the root frame in glTF's, float32."""
    if path == "rotation":
        turned = np.concatenate([values[:, :3] @ FROM_ROOT_FRAME.T, values[:, 3:]], axis=1)
        return (turned / np.linalg.norm(turned, axis=1, keepdims=True)).astype(np.float32)
    return in_gltf_frame(values)
