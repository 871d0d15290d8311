"""Which nodes of a glTF file are joints, of its skins or the humanoid bones of VRM and VRMA, and what hangs on what."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TypeVar

from physkin_core.file_reading import ContentError, shown
from physkin_core.formats.gltf_document import GltfEntry
from physkin_core.formats.gltf_file import GltfFile

__all__ = ["humanoid_nodes", "nearest_above", "skin_nodes", "with_nodes_above"]


Value = TypeVar("Value")


def with_nodes_above(file: GltfFile, nodes: Iterable[int]) -> list[int]:
    """Nodes and all that they hang on, parents first."""
    inside = set(nodes)
    inside.update(int(file.node_parents[node]) for node in reversed(file.node_order) if node in inside)
    return [node for node in file.node_order if node in inside]


def nearest_above(file: GltfFile, values: Mapping[int, Value]) -> dict[int, Value]:
    """By node the value of itself or of the nearest node above that has one, where there is one."""
    found: dict[int, Value] = {}
    for node in file.node_order:
        if (value := values.get(node, found.get(int(file.node_parents[node])))) is not None:
            found[node] = value
    return found


def skin_nodes(file: GltfFile, skin: GltfEntry) -> list[int]:
    """Nodes that are the joints of a skin. Raises ContentError where there are none, or no such nodes."""
    nodes = skin.indices("joints")
    if not nodes or max(nodes) >= len(file.nodes):
        raise ContentError(f"joints of {skin.where} are {shown(nodes)}, allowed are nodes 0 to {len(file.nodes) - 1}")
    return nodes


def humanoid_nodes(file: GltfFile) -> dict[str, int] | None:
    """Node by VRM humanoid bone, or None for a file that is neither VRM nor VRMA. Raises ContentError."""
    extensions = file.document.entry("extensions")
    for name in ("VRMC_vrm", "VRMC_vrm_animation"):
        if name in extensions:
            bones = extensions.entry(name).entry("humanoid").entry("humanBones")
            nodes = {bone: bones.entry(bone).integer("node") for bone in bones.members}
            break
    else:
        if "VRM" not in extensions:
            return None
        listed = extensions.entry("VRM").entry("humanoid").entries("humanBones")
        nodes = {bone.text("bone"): bone.integer("node") for bone in listed}
    for node in nodes.values():
        file.document.item("nodes", node)
    return nodes
