"""Reading glTF 2.0 files (GLB, glTF, VRM) into arrays: buffers, accessors, node transforms, triangles.

Nothing here knows about avatars. Dimensions: `N` elements of an accessor, `g` nodes. glTF's own frame and units.
"""

from __future__ import annotations

import base64
import struct
from pathlib import Path
from urllib.parse import unquote

import numpy as np

from physkin_core.avatar.avatar import AvatarError
from physkin_core.avatar.gltf_compression import DRACO, draco_mesh, meshopt_extension, meshopt_view

__all__ = ["GltfFile"]

GLB_MAGIC = b"glTF"
GLB_HEADER = 12  # [bytes]
COMPONENTS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
COMPONENT_TYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
TRIANGLES, TRIANGLE_STRIP, TRIANGLE_FAN = 4, 5, 6
LARGEST_BUFFER = 1 << 29
"""[bytes] Of a file beside a .gltf."""


class GltfFile:
    """An open glTF file. Raises AvatarError where the file is truncated, malformed or compressed in an unknown way.

    document: pygltflib's `GLTF2`. node_parents: (g,) int, -1 for none. node_order: a parent before its children.
    node_worlds: (g, 4, 4) from node to scene.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.document, blob = _parse(path)
        self._decoded_views: dict[int, bytes] = {}
        self._draco_meshes: dict[int, object] = {}
        self.buffers = [self._buffer(index, blob) for index in range(len(self.document.buffers))]
        self.node_parents, self.node_order = self._hierarchy()
        self.node_worlds = np.empty((len(self.document.nodes), 4, 4))
        for node in self.node_order:
            local, parent = _local_transform(self.document.nodes[node]), self.node_parents[node]
            self.node_worlds[node] = local if parent < 0 else self.node_worlds[parent] @ local

    def accessor(self, index: int) -> np.ndarray:
        """(N, components) array of an accessor: integers as stored, floats and normalised integers as float64."""
        accessor = self._item("accessor", self.document.accessors, index)
        width, dtype = COMPONENTS[accessor.type], np.dtype(COMPONENT_TYPES[accessor.componentType])
        if accessor.bufferView is None:
            largest = sum(map(len, self.buffers))  # others at least have as many bytes
            if not 0 < accessor.count <= largest:
                raise AvatarError(
                    f"avatar {self.path}: accessor {index} has {accessor.count} elements without data, allowed "
                    f"1 to {largest}"
                )
            data = np.zeros((accessor.count, width), dtype=dtype)
        else:
            data = self._view(accessor.bufferView, accessor.byteOffset or 0, accessor.count, width, dtype)
        if accessor.sparse is not None and accessor.sparse.count:
            at, values = accessor.sparse.indices, accessor.sparse.values
            index_type = np.dtype(COMPONENT_TYPES[at.componentType])
            rows = self._view(at.bufferView, at.byteOffset or 0, accessor.sparse.count, 1, index_type)[:, 0]
            data = data.copy()
            data[rows] = self._view(values.bufferView, values.byteOffset or 0, accessor.sparse.count, width, dtype)
        return _numbers(data, dtype, accessor.normalized)

    def attribute(self, primitive, name: str) -> np.ndarray | None:
        """(V, components) a primitive's vertex attribute, as `accessor` gives it; None where there is none."""
        index = getattr(primitive.attributes, name, None)
        draco = (primitive.extensions or {}).get(DRACO)
        if index is None or draco is None or name not in draco["attributes"]:
            return None if index is None else self.accessor(index)
        accessor = self._item("accessor", self.document.accessors, index)
        found = self._draco_mesh(draco["bufferView"]).get_attribute_by_unique_id(draco["attributes"][name])
        data = np.empty(0) if found is None else found["data"]
        shape = (accessor.count, COMPONENTS[accessor.type])
        if data.shape != shape:
            raise AvatarError(
                f"avatar {self.path}: {DRACO} has {name} as {data.shape}, accessor {index} {shape}; these must agree"
            )
        return _numbers(data, np.dtype(COMPONENT_TYPES[accessor.componentType]), accessor.normalized)

    def triangles(self, primitive) -> np.ndarray:
        """(f, 3) vertex indices of a primitive; empty for points and lines."""
        if draco := (primitive.extensions or {}).get(DRACO):
            return np.asarray(self._draco_mesh(draco["bufferView"]).faces, dtype=np.int64).reshape(-1, 3)
        if primitive.indices is None:
            corners = np.arange(len(self.accessor(primitive.attributes.POSITION)))
        else:
            corners = self.accessor(primitive.indices)[:, 0]
        mode = TRIANGLES if primitive.mode is None else primitive.mode
        if mode == TRIANGLES:
            return corners[: len(corners) // 3 * 3].reshape(-1, 3)
        if mode == TRIANGLE_FAN:
            return np.stack([np.full(len(corners) - 2, corners[0]), corners[1:-1], corners[2:]], axis=1)
        if mode == TRIANGLE_STRIP:
            strip = np.stack([corners[:-2], corners[1:-1], corners[2:]], axis=1)
            strip[1::2] = strip[1::2, ::-1]
            return strip
        return np.empty((0, 3), dtype=np.int64)

    def picture(self, index: int) -> bytes:
        """The file of an image."""
        image = self._item("image", self.document.images, index)
        if image.bufferView is None:
            return self._content(f"image {index}", image.uri or "", LARGEST_BUFFER)
        view, data, first = self._view_bytes(image.bufferView)
        return bytes(data[first : first + view.byteLength])

    def scene_nodes(self) -> list[int]:
        """Nodes of the default scene, parents first; all of them when the file names no scene."""
        scenes = self.document.scenes
        if not scenes:
            return self.node_order
        inside = set(scenes[self.document.scene or 0].nodes)
        for node in self.node_order:
            if self.node_parents[node] in inside:
                inside.add(node)
        return [node for node in self.node_order if node in inside]

    def _item(self, kind: str, items: list, index: int):
        """Of a list in the document; negative indices, which Python would count from the end, are refused."""
        if not 0 <= index < len(items):
            raise AvatarError(f"avatar {self.path} is malformed: {kind} {index}, allowed 0 to {len(items) - 1}")
        return items[index]

    def _view(self, index: int, offset: int, count: int, width: int, dtype: np.dtype) -> np.ndarray:
        view, data, first = self._view_bytes(index)
        start, item = first + offset, width * dtype.itemsize
        stride = view.byteStride or item
        end = start + stride * (count - 1) + item
        limit = min(first + view.byteLength, len(data))
        if count < 1 or start < 0 or end > limit:
            raise AvatarError(
                f"avatar {self.path}: an accessor of {count} elements needs bytes {start} to {end} of buffer "
                f"{view.buffer}, but its view ends at {limit}; the file is truncated or malformed"
            )
        return np.ndarray((count, width), dtype, buffer=data, offset=start, strides=(stride, dtype.itemsize))

    def _view_bytes(self, index: int) -> tuple:
        """A buffer view, the bytes that hold it and where in them it starts; decompressed where it is compressed."""
        view = self._item("buffer view", self.document.bufferViews, index)
        compressed = meshopt_extension(view.extensions)
        if compressed is None:
            return view, self._item("buffer", self.buffers, view.buffer), view.byteOffset or 0
        if index not in self._decoded_views:
            data = self._item("buffer", self.buffers, compressed["buffer"])
            self._decoded_views[index] = meshopt_view(compressed, data, str(self.path))
        return view, self._decoded_views[index], 0

    def _draco_mesh(self, index: int):
        """DracoPy's mesh in a buffer view."""
        if index not in self._draco_meshes:
            view, data, first = self._view_bytes(index)
            self._draco_meshes[index] = draco_mesh(data[first : first + view.byteLength], str(self.path))
        return self._draco_meshes[index]

    def _buffer(self, index: int, blob: bytes | None) -> bytes:
        buffer = self.document.buffers[index]
        uri, compressed = buffer.uri, meshopt_extension(buffer.extensions)
        if uri is None:
            data = blob or b"" if index == 0 else b""
            if compressed is not None and compressed.get("fallback"):  # views of it are decompressed from another
                return data
        else:
            data = self._content(f"buffer {index}", uri, buffer.byteLength)
        if len(data) < buffer.byteLength:
            raise AvatarError(
                f"avatar {self.path} is truncated: buffer {index} has {len(data)} of {buffer.byteLength} bytes"
            )
        return data

    def _content(self, what: str, uri: str, length: int) -> bytes:
        """What a URI holds; of a file the first `length` bytes. It must lie in the avatar's folder, links followed."""
        if uri.startswith("data:"):
            return base64.b64decode(uri.split(",", 1)[1])
        if "://" in uri:
            raise AvatarError(f"avatar {self.path}: {what} is at {uri}; only files beside the avatar are read")
        name, folder = unquote(uri), self.path.parent.resolve()
        beside = (folder / name).resolve()
        if not beside.is_relative_to(folder):
            raise AvatarError(f"avatar {self.path}: {what} is {name!r}, outside the avatar's folder; it must be in it")
        if not beside.is_file():
            raise AvatarError(f"avatar {self.path}: {what} is {name!r}, but {beside} does not exist")
        if not 0 <= length <= LARGEST_BUFFER:
            raise AvatarError(f"avatar {self.path}: {what} has {length} bytes, allowed are 0 to {LARGEST_BUFFER}")
        with open(beside, "rb") as file:
            return file.read(length)

    def _hierarchy(self) -> tuple[np.ndarray, list[int]]:
        parents = np.full(len(self.document.nodes), -1)
        for index, node in enumerate(self.document.nodes):
            for child in node.children or []:
                self._item("node", self.document.nodes, child)
                if parents[child] >= 0 or child == index:
                    raise AvatarError(f"avatar {self.path}: node {child} has two parents, allowed is one")
                parents[child] = index
        order = [int(node) for node in np.flatnonzero(parents < 0)]
        for node in order:
            order += self.document.nodes[node].children or []
        if len(order) != len(parents):
            raise AvatarError(f"avatar {self.path}: its nodes form a loop, allowed is a tree")
        return parents, order


def _parse(path: Path) -> tuple:
    """The document and the embedded binary chunk."""
    from pygltflib import GLTF2

    data = path.read_bytes()
    if data[:4] != GLB_MAGIC and not data[:64].lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"{"):
        found = f"begins with {data[:16]!r}" if data else "is empty"
        allowed = f"allowed are {GLB_MAGIC!r} and JSON"
        raise AvatarError(f"avatar {path} is not a glTF file: it {found}, {allowed}; export or download it again")
    try:
        if data[:4] != GLB_MAGIC:
            return GLTF2.from_json(data.decode("utf-8-sig"), infer_missing=True), None
        if len(data) < GLB_HEADER:
            raise AvatarError(f"avatar {path} is truncated: {len(data)} of at least {GLB_HEADER} bytes")
        version, length = struct.unpack_from("<II", data, 4)
        if version != 2:
            raise AvatarError(f"avatar {path} is glTF version {version}, allowed is 2")
        if length > len(data):
            raise AvatarError(f"avatar {path} is truncated: {len(data)} of {length} bytes")
        document = GLTF2.load_from_bytes(data)
    except AvatarError:
        raise
    except Exception as error:  # whatever the parser trips over, the file is not a readable glTF
        raise AvatarError(f"avatar {path} is not a readable glTF file: {type(error).__name__}: {error}") from error
    return document, document.binary_blob()


def _numbers(data: np.ndarray, dtype: np.dtype, normalized: bool | None) -> np.ndarray:
    """Data stored as `dtype`: floats and normalised integers as float64, integers as int64."""
    if dtype.kind == "f":
        return data.astype(np.float64)
    if normalized:
        return np.maximum(data.astype(np.float64) / np.iinfo(dtype).max, -1.0)
    return data.astype(np.int64)


def _local_transform(node) -> np.ndarray:
    """(4, 4) from the node to its parent."""
    from scipy.spatial.transform import Rotation

    if node.matrix:
        return np.array(node.matrix, dtype=np.float64).reshape(4, 4).T
    rotation = Rotation.from_quat(node.rotation or (0, 0, 0, 1)).as_matrix()
    local = np.eye(4)
    local[:3, :3] = rotation * np.array(node.scale or (1, 1, 1), dtype=np.float64)
    local[:3, 3] = node.translation or (0, 0, 0)
    return local
