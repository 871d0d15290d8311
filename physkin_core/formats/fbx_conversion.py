"""`python -m physkin_core.formats.fbx_conversion`: an FBX file comes in, a GLB goes out; `fbx_as_glb` begins it.

Dimensions: `V` vertices of a mesh, `K` influences.
"""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Iterator
from threading import Thread
from urllib.parse import quote

import numpy as np
import ufbx
from scipy.spatial.transform import Rotation

from physkin_core.formats.fbx_file import MOST_MEMORY, REFUSED
from physkin_core.formats.gltf_builder import GltfBuilder, glb
from physkin_core.worker.serving import end_with, limit_resources

FASTEST = 60.0
"""[Hz] at which a take is sampled; a file's own rate where that is lower."""
MOST_INFLUENCES = 16
"""Of a vertex, its strongest."""
PINNED = 1 << 24
"""References added to an element, more than it is asked for."""
PATHS = ("translation", "rotation", "scale")
OPTIONS = dict(
    file_format=ufbx.FileFormat.FBX,
    skip_skin_vertices=True,
    skip_mesh_parts=True,
    target_axes=ufbx.axes_right_handed_y_up,
    target_unit_meters=1.0,
    space_conversion=ufbx.SpaceConversion.MODIFY_GEOMETRY,
    geometry_transform_handling=ufbx.GeometryTransformHandling.MODIFY_GEOMETRY,
    inherit_mode_handling=ufbx.InheritModeHandling.COMPENSATE,
    handedness_conversion_axis=ufbx.MirrorAxis.X,
)


def converted(content: bytes, *, clips: bool) -> bytes:
    """The GLB. Raises UfbxError and MemoryError."""
    scene = ufbx.load_memory(content, ignore_animation=not clips, **OPTIONS)
    for element in scene.elements:  # ufbx 0.0.5 does not count references to them, and frees what is in use
        ctypes.c_ssize_t.from_address(id(element)).value += PINNED
    builder = GltfBuilder({"generator": "ufbx"})
    lists: dict = {key: [] for key in ("nodes", "meshes", "skins", "materials", "textures", "images", "animations")}
    nodes = list(scene.nodes)
    builder.document |= lists | {"scene": 0, "scenes": [{"nodes": [child.typed_id for child in nodes[0].children]}]}
    for node, bound in zip(nodes, _bind_transforms(scene, nodes)):
        entry = {"name": node.name, **dict(zip(PATHS, bound))}
        if len(node.children) and not node.is_root:
            entry["children"] = [child.typed_id for child in node.children]
        lists["nodes"].append(entry)
        if node.mesh is not None and node.visible and node.mesh.num_triangles:
            _add_mesh(builder, node, entry)
    for material in scene.materials:
        _add_material(builder, material)
    if clips:
        _add_clips(builder, scene, nodes)
    for key in [key for key, entries in lists.items() if not entries]:
        del builder.document[key]
    return glb(builder)


def _bind_transforms(scene: ufbx.Scene, nodes: list[ufbx.Node]) -> Iterator[tuple[list, list, list]]:
    """Translation, rotation and scale of each node, parents first: in the bind pose where the file states that."""
    binds = [(cluster.bone_node, cluster.bind_to_world) for cluster in scene.skin_clusters]
    poses = [pose for pose in scene.poses if pose.is_bind_pose]
    binds += [(bone.bone_node, bone.bone_to_world) for pose in poses for bone in pose.bone_poses]
    stated: dict[int, np.ndarray] = {}
    for node, matrix in binds:
        if node is not None and abs(np.linalg.det(_square(matrix))) > 1e-9:
            stated.setdefault(node.typed_id, _square(matrix))
    worlds = np.empty((len(nodes), 4, 4))
    for index, node in enumerate(nodes):
        above = np.eye(4) if node.parent is None else worlds[node.parent.typed_id]
        worlds[index] = stated.get(index, above @ _square(node.node_to_parent))
        local = np.linalg.pinv(above) @ worlds[index]
        scale = np.linalg.norm(local[:3, :3], axis=0) * (1 if np.linalg.det(local) >= 0 else -1)
        turn = Rotation.from_matrix(local[:3, :3] / np.where(scale == 0, 1, scale)).as_quat()
        yield local[:3, 3].tolist(), turn.tolist(), scale.tolist()


def _square(matrix: ufbx.Matrix) -> np.ndarray:
    """(4, 4)."""
    return np.vstack([np.array(matrix).T, [0, 0, 0, 1]])


def _add_mesh(builder: GltfBuilder, node: ufbx.Node, entry: dict) -> None:
    """A node's mesh, shaped by the blend shapes that are set, and its skin. entry: of the node."""
    mesh, document = node.mesh, builder.document
    positions, uv = np.array(list(mesh.vertices)), mesh.vertex_uv
    for key in (k for blend in mesh.blend_deformers for channel in blend.channels for k in channel.keyframes):
        if key.effective_weight:
            moved = np.array(list(key.shape.offset_vertices), dtype=int)
            positions[moved] += key.effective_weight * np.array(list(key.shape.position_offsets)).reshape(-1, 3)
    clusters = [each for skin in mesh.skin_deformers for each in skin.clusters if each.bone_node is not None]
    to_scene = _square(clusters[0].bind_to_world) @ _square(clusters[0].geometry_to_bone) if clusters else np.eye(4)
    positions = positions @ to_scene[:3, :3].T + to_scene[:3, 3]
    different = max(1, len(uv.values))
    key = np.array(list(mesh.vertex_indices)) * different + np.array(list(uv.indices) or [0] * mesh.num_indices)
    key, corners = np.unique(key, return_inverse=True)
    vertex, place = np.divmod(key, different)
    attributes = {"POSITION": builder.add_accessor(positions[vertex].astype(np.float32))}
    if uv.exists:
        places = np.array(list(uv.values))[place] * [1, -1] + [0, 1]
        attributes["TEXCOORD_0"] = builder.add_accessor(places.astype(np.float32))
    if clusters:
        to_bones = [_square(cluster.geometry_to_bone) @ np.linalg.pinv(to_scene) for cluster in clusters]
        matrices = np.stack([to_bone.T.reshape(16) for to_bone in to_bones])
        skin = {"inverseBindMatrices": builder.add_accessor(matrices.astype(np.float32))}
        entry["skin"] = len(document["skins"])
        document["skins"].append(skin | {"joints": [cluster.bone_node.typed_id for cluster in clusters]})
        for name, values in zip(("JOINTS", "WEIGHTS"), _influences(clusters, len(positions))):
            for first in range(0, values.shape[1], 4):
                four = values[vertex, first : first + 4]
                attributes[f"{name}_{first // 4}"] = builder.add_accessor(four)
    faces = np.array(list(mesh.faces))
    counts = np.maximum(faces[:, 1] - 2, 0)  # triangles of a fan
    start, face = np.repeat(faces[:, 0], counts), np.repeat(np.arange(len(faces)), counts)
    step = np.arange(len(start)) - np.repeat(np.cumsum(counts) - counts, counts)
    triangles = corners[np.stack([start, start + step + 1, start + step + 2], axis=1)]
    materials = list(node.materials) or list(mesh.materials)
    used = np.array(list(mesh.face_material) or [0] * len(faces))[face]
    primitives = []
    for number in np.unique(used):
        indices = builder.add_accessor(triangles[used == number].astype(np.uint32).reshape(-1))
        material = {"material": materials[number].typed_id} if number < len(materials) else {}
        primitives.append({"attributes": attributes, "indices": indices, **material})
    entry["mesh"] = len(document["meshes"])
    document["meshes"].append({"name": mesh.name, "primitives": primitives})


def _influences(clusters: list[ufbx.SkinCluster], count: int) -> tuple[np.ndarray, np.ndarray]:
    """Indices of clusters and weights (V, K) of `count` vertices; K is a multiple of four."""
    vertex = np.concatenate([list(cluster.vertices) for cluster in clusters]).astype(int)
    weight = np.concatenate([list(cluster.weights) for cluster in clusters])
    cluster = np.repeat(np.arange(len(clusters)), [cluster.num_weights for cluster in clusters])
    order = np.lexsort([-weight, vertex])
    order = order[weight[order] > 0]
    vertex, weight, cluster = vertex[order], weight[order], cluster[order]
    rank = np.arange(len(vertex)) - np.searchsorted(vertex, vertex)
    strong = rank < MOST_INFLUENCES
    shape = count, 4 * (int(rank[strong].max(initial=0)) // 4 + 1)
    joints, weights = np.zeros(shape, dtype=np.uint16), np.zeros(shape, dtype=np.float32)
    for values, given in ((joints, cluster), (weights, weight)):
        values[vertex[strong], rank[strong]] = given[strong]
    return joints, weights


def _add_material(builder: GltfBuilder, material: ufbx.Material) -> None:
    """Its base colour, or the picture of it, and whether that may be clear."""
    document, base = builder.document, material.pbr.base_color
    shading: dict = {"baseColorFactor": [*np.clip(base.value_vec4[:3], 0, 1).tolist(), 1.0]}
    if (picture := base.texture) is not None:
        shading = {"baseColorTexture": {"index": len(document["textures"])}}
        document["textures"].append({"source": len(document["images"])})
        name = (picture.relative_filename or picture.filename).replace("\\", "/")
        if ":" in name or name.startswith(("/", "..")):  # a folder of another machine
            name = name.rpartition("/")[2]
        image: dict = {"uri": quote(name)}
        if content := picture.content:
            kind = "image/png" if content.startswith(b"\x89PNG") else "image/jpeg"
            image = {"bufferView": builder.add_view(np.frombuffer(content, dtype=np.uint8)), "mimeType": kind}
        document["images"].append(image)
    clear = "MASK" if material.pbr.opacity.texture is not None else "OPAQUE"
    document["materials"].append({"name": material.name, "pbrMetallicRoughness": shading, "alphaMode": clear})


def _add_clips(builder: GltfBuilder, scene: ufbx.Scene, nodes: list[ufbx.Node]) -> None:
    """Each take as an animation of all nodes but the root."""
    for take in scene.anim_stacks:
        begin, end = take.time_begin, take.time_end
        if end <= begin:  # left out, as what is usual
            curves = [curve for layer in take.layers for value in layer.anim_values for curve in value.curves if curve]
            begin = min((curve.min_time for curve in curves), default=0.0)
            end = max((curve.max_time for curve in curves), default=0.0)
        rate = min(scene.settings.frames_per_second or FASTEST, FASTEST)
        times = np.arange(int((end - begin) * rate + 1e-3) + 1) / rate
        animation: dict = {"name": take.name, "channels": [], "samplers": []}
        at = builder.add_accessor(times.astype(np.float32))
        for index, node in enumerate(nodes[1:], start=1):
            posed = [node.evaluate_transform(take.anim, time) for time in (begin + times).tolist()]
            for path in PATHS:
                target = {"node": index, "path": path}
                animation["channels"].append({"sampler": len(animation["samplers"]), "target": target})
                output = builder.add_accessor(np.array([getattr(each, path) for each in posed], dtype=np.float32))
                animation["samplers"].append({"input": at, "output": output})
        builder.document["animations"].append(animation)


if __name__ == "__main__":
    Thread(target=end_with, args=(sys.stdout.fileno(),), daemon=True).start()
    limit_resources(MOST_MEMORY)
    try:
        answer, status = converted(sys.stdin.buffer.read(), clips=sys.argv[1] == "clips"), 0
    except (MemoryError, ufbx.OutOfMemoryError):
        answer, status = f"it takes more than {MOST_MEMORY} MiB of memory; use a smaller file".encode(), REFUSED
    except ufbx.UfbxError as error:
        answer, status = f"it is not FBX that can be read: {error}; export it again".encode(), REFUSED
    sys.stdout.buffer.write(answer)
    sys.stdout.buffer.flush()
    os._exit(status)  # before ufbx frees what it has not counted
