"""Reading glTF 2.0 files (GLB, glTF, VRM), and FBX as glTF, into arrays: buffers, accessors, transforms, triangles.

Dimensions: `N` elements of an accessor, `g` nodes. glTF's own frame and units.
"""

from __future__ import annotations

import base64
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import unquote

import numpy as np

from physkin_core.file_reading import ContentError, file_beside, read_bytes, shown
from physkin_core.formats.fbx_file import FBX_SUFFIX, fbx_as_glb
from physkin_core.formats.gltf_compression import DRACO, DracoMesh, draco_mesh, meshopt_extension, meshopt_view
from physkin_core.formats.gltf_document import GltfEntry, parse_gltf

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

__all__ = ["TRANSFORM_PARTS", "GltfFile", "local_transforms", "node_transform_parts", "rotations_of"]

COMPONENTS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
INDEX_TYPES = {5121: np.dtype("<u1"), 5123: np.dtype("<u2"), 5125: np.dtype("<u4")}
COMPONENT_TYPES = {5120: np.dtype("<i1"), 5122: np.dtype("<i2"), **INDEX_TYPES, 5126: np.dtype("<f4")}
TRIANGLES, TRIANGLE_STRIP, TRIANGLE_FAN = 4, 5, 6
TRANSFORM_PARTS = {"translation": (0.0, 0, 0), "rotation": (0.0, 0, 0, 1), "scale": (1.0, 1, 1)}
"""Of a node, and what they are where it does not say."""
SHORTEST_QUATERNION = 1e-6
"""A rotation's quaternion that is shorter was never set."""


class GltfFile:
    """An open glTF file. Raises ContentError where the file is truncated, malformed or compressed in an unknown
    way. What it declares is compared with what it holds before memory is taken for it.

    clips: whether those of an FBX file are wanted, too, which takes longer.
    document: its JSON. nodes: (g,). node_parents: (g,) int, -1 for none. node_order: a parent before its children.
    node_locals, node_worlds: (g, 4, 4) from node to its parent, and to the scene. mended: why a node is taken to be
    where its parent is, or not to be turned, by node. lenient: mend transforms that are not finite, too.
    """

    def __init__(self, path: Path, *, lenient: bool = False, clips: bool = True) -> None:
        self.path = path
        content = read_bytes(path)
        if path.suffix.lower() == FBX_SUFFIX:
            content = fbx_as_glb(content, clips=clips)
        self.document, binary = parse_gltf(content)
        self.nodes = self.document.entries("nodes")
        self._decoded_views: dict[int, bytes] = {}
        self._draco_meshes: dict[int, DracoMesh] = {}
        entries = self.document.entries("buffers")
        self.buffers = [self._buffer(index, entry, binary) for index, entry in enumerate(entries)]
        self.node_children = [node.indices("children") for node in self.nodes]
        self.node_parents, self.node_order = self._hierarchy()
        self.mended: dict[int, str] = {}
        self.node_locals = np.array([self._local_transform(node, lenient) for node in range(len(self.nodes))])
        self.node_worlds = self.node_locals.reshape(-1, 4, 4).copy()
        for node in self.node_order:
            if (parent := self.node_parents[node]) >= 0:
                self.node_worlds[node] = self.node_worlds[parent] @ self.node_locals[node]

    def accessor(self, index: int) -> np.ndarray:
        """(N, components) array of an accessor: integers as stored, floats and normalised integers as float64."""
        accessor = self.document.item("accessors", index)
        width, dtype = accessor.choice("type", COMPONENTS), accessor.choice("componentType", COMPONENT_TYPES)
        count = accessor.integer("count")
        if "bufferView" in accessor:
            data = self._view(accessor, count, width, dtype)
        else:
            largest = sum(map(len, self.buffers))  # others at least have as many bytes
            if not 0 < count <= largest:
                raise ContentError(
                    f"accessors[{index}] has {count} elements without data, allowed are 1 to {largest}; export it again"
                )
            data = np.zeros((count, width), dtype=dtype)
        if "sparse" in accessor:
            data = self._with_sparse(accessor.entry("sparse"), data)
        return _numbers(data, dtype, accessor)

    def attribute(self, primitive: GltfEntry, name: str) -> np.ndarray | None:
        """(V, components) a primitive's vertex attribute, as `accessor` gives it; None where there is none."""
        index, draco = primitive.entry("attributes").index(name), _draco(primitive)
        if index is None or draco is None or name not in draco.entry("attributes"):
            return None if index is None else self.accessor(index)
        accessor = self.document.item("accessors", index)
        shape = (accessor.integer("count"), accessor.choice("type", COMPONENTS))
        found = self._draco_mesh(draco).get_attribute_by_unique_id(draco.entry("attributes").integer(name))
        data = np.empty(0) if found is None else found["data"]
        if data.shape != shape:
            raise ContentError(
                f"{DRACO} has {name} as {data.shape}, accessors[{index}] {shape}; these must agree, export it again"
            )
        return _numbers(data, accessor.choice("componentType", COMPONENT_TYPES), accessor)

    def triangles(self, primitive: GltfEntry) -> np.ndarray:
        """(f, 3) vertex indices of a primitive; empty for points and lines."""
        indices = primitive.index("indices")
        if draco := _draco(primitive):
            return np.asarray(self._draco_mesh(draco).faces, dtype=np.int64).reshape(-1, 3)
        if indices is None:
            corners = np.arange(len(self.accessor(primitive.entry("attributes").integer("POSITION"))))
        else:
            corners = self.accessor(indices)[:, 0]
        mode = primitive.integer("mode", TRIANGLES)
        if mode == TRIANGLES:
            return corners[: len(corners) // 3 * 3].reshape(-1, 3)
        if mode not in (TRIANGLE_FAN, TRIANGLE_STRIP) or len(corners) < 3:
            return np.empty((0, 3), dtype=np.int64)
        if mode == TRIANGLE_FAN:
            return np.stack([np.full(len(corners) - 2, corners[0]), corners[1:-1], corners[2:]], axis=1)
        strip = np.stack([corners[:-2], corners[1:-1], corners[2:]], axis=1)
        strip[1::2] = strip[1::2, ::-1]
        return strip

    def picture(self, index: int) -> bytes:
        """The file of an image."""
        image = self.document.item("images", index)
        if "bufferView" not in image:
            return self._content(f"image {index}", image.text("uri"))
        return bytes(self._view_bytes(image.integer("bufferView")))

    def scene_nodes(self) -> list[int]:
        """Nodes of the default scene, parents first; all of them when the file names no scene."""
        if not self.document.count("scenes"):
            return self.node_order
        inside = set(self.document.item("scenes", self.document.integer("scene", 0)).indices("nodes"))
        for node in self.node_order:
            if self.node_parents[node] in inside:
                inside.add(node)
        return [node for node in self.node_order if node in inside]

    def _local_transform(self, number: int, lenient: bool) -> np.ndarray:
        """(4, 4) from the node to its parent."""
        node = self.nodes[number]
        try:
            matrix, parts = node.numbers("matrix", 16), node_transform_parts(node)
        except ContentError as error:
            if not lenient:
                raise
            self.mended[number] = str(error)
            return np.eye(4)
        if matrix is not None:
            return np.array(matrix).reshape(4, 4).T
        if np.linalg.norm(quaternion := parts["rotation"]) < SHORTEST_QUATERNION:
            self.mended[number] = f"{node.where}.rotation is {quaternion.tolist()}, which turns by nothing"
        return local_transforms(**{part: value[None] for part, value in parts.items()})[0]

    def _with_sparse(self, sparse: GltfEntry, data: np.ndarray) -> np.ndarray:
        """Data (N, components) with some of its elements replaced."""
        count = sparse.integer("count", 0)
        if count == 0:
            return data
        at = sparse.entry("indices")
        rows = self._view(at, count, 1, at.choice("componentType", INDEX_TYPES))[:, 0]
        if rows.max() >= len(data):
            raise ContentError(f"{sparse.where} replaces element {rows.max()}, allowed are 0 to {len(data) - 1}")
        data = data.copy()
        data[rows] = self._view(sparse.entry("values"), count, data.shape[1], data.dtype)
        return data

    def _view(self, user: GltfEntry, count: int, width: int, dtype: np.dtype) -> np.ndarray:
        """(count, width) of a buffer view, without a copy. user: what names the view and where in it to begin."""
        index, offset = user.integer("bufferView"), user.integer("byteOffset", 0)
        view, item = self.document.item("bufferViews", index), width * dtype.itemsize
        stride = view.integer("byteStride", 0) or item
        if stride < item:
            raise ContentError(
                f"bufferViews[{index}] has a stride of {stride} bytes, {user.where} needs {item} or more"
            )
        data, length = self._view_bytes(index), offset + stride * (count - 1) + item
        if count < 1 or length > len(data):
            raise ContentError(
                f"{user.where} of {count} elements needs {length} bytes of bufferViews[{index}], which has "
                f"{len(data)}; the file is truncated or malformed"
            )
        return np.ndarray((count, width), dtype, buffer=data, offset=offset, strides=(stride, dtype.itemsize))

    def _view_bytes(self, index: int) -> memoryview:
        """The bytes of a buffer view, as many as its buffer has; decompressed where it is compressed."""
        view = self.document.item("bufferViews", index)
        length, compressed = view.integer("byteLength"), meshopt_extension(view)
        if compressed is None:
            first = view.integer("byteOffset", 0)
            return memoryview(self._buffer_bytes(view.integer("buffer")))[first : first + length]
        if index not in self._decoded_views:
            data = self._buffer_bytes(compressed.integer("buffer"))
            self._decoded_views[index] = meshopt_view(compressed, length, data)
        return memoryview(self._decoded_views[index])

    def _buffer_bytes(self, index: int) -> bytes:
        self.document.item("buffers", index)
        return self.buffers[index]

    def _draco_mesh(self, draco: GltfEntry) -> DracoMesh:
        """DracoPy's mesh of a primitive that the extension belongs to."""
        index = draco.integer("bufferView")
        if index not in self._draco_meshes:
            self._draco_meshes[index] = draco_mesh(bytes(self._view_bytes(index)))
        return self._draco_meshes[index]

    def _buffer(self, index: int, buffer: GltfEntry, binary: bytes) -> bytes:
        length, compressed = buffer.integer("byteLength"), meshopt_extension(buffer)
        if "uri" not in buffer:
            data = binary if index == 0 else b""
            if compressed is not None and compressed.members.get("fallback"):  # its views are decompressed from another
                return data
        else:
            data = self._content(f"buffer {index}", buffer.text("uri"))
        if len(data) < length:
            raise ContentError(f"it is truncated: buffer {index} has {len(data)} of {length} bytes")
        return data

    def _content(self, what: str, uri: str) -> bytes:
        """What a URI holds: it, or a file beside this one."""
        if uri.startswith("data:"):
            return base64.b64decode(uri.partition(",")[2])
        if "://" in uri:
            raise ContentError(f"{what} is at {shown(uri)}; only files beside it are read")
        return read_bytes(file_beside(self.path, unquote(uri)))

    def _hierarchy(self) -> tuple[np.ndarray, list[int]]:
        parents = np.full(len(self.nodes), -1)
        for index, children in enumerate(self.node_children):
            for child in children:
                self.document.item("nodes", child)
                if parents[child] >= 0 or child == index:
                    raise ContentError(f"nodes[{child}] has two parents, allowed is one")
                parents[child] = index
        order = [int(node) for node in np.flatnonzero(parents < 0)]
        for node in order:
            order += self.node_children[node]
        if len(order) != len(parents):
            raise ContentError("its nodes form a loop, allowed is a tree")
        return parents, order


def _draco(primitive: GltfEntry) -> GltfEntry | None:
    extensions = primitive.entry("extensions")
    return extensions.entry(DRACO) if DRACO in extensions else None


def _numbers(data: np.ndarray, dtype: np.dtype, accessor: GltfEntry) -> np.ndarray:
    """Data stored as `dtype`: floats and normalised integers as float64, integers as int64."""
    if dtype.kind == "f":
        return data.astype(np.float64)
    if accessor.members.get("normalized"):
        return np.maximum(data.astype(np.float64) / np.iinfo(dtype).max, -1.0)
    return data.astype(np.int64)


def node_transform_parts(node: GltfEntry) -> dict[str, np.ndarray]:
    """Translation (3,), rotation (4,) and scale (3,) of a node, those that it leaves out as well. Raises ContentError
    where they are not finite numbers."""
    return {part: np.array(node.numbers(part, len(usual)) or usual) for part, usual in TRANSFORM_PARTS.items()}


def rotations_of(quaternions: np.ndarray) -> Rotation:
    """Of quaternions (T, 4) of any length; none of those of no length."""
    from scipy.spatial.transform import Rotation

    long = np.linalg.norm(quaternions, axis=1, keepdims=True) >= SHORTEST_QUATERNION
    return Rotation.from_quat(np.where(long, quaternions, TRANSFORM_PARTS["rotation"]))


def local_transforms(translation: np.ndarray, rotation: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """(T, 4, 4) from a node to its parent, of its parts (T, 3 or 4)."""
    transforms = np.tile(np.eye(4), (len(rotation), 1, 1))
    transforms[:, :3, :3] = rotations_of(rotation).as_matrix() * scale[:, None]
    transforms[:, :3, 3] = translation
    return transforms
