"""A glTF file, read by pygltflib and computed as engines do."""

import numpy as np
from pygltflib import GLTF2
from scipy.spatial.transform import Rotation

from physkin_core.formats.gltf_builder import FROM_ROOT_FRAME
from physkin_core.runtime.evaluator import Skinner

TYPES = {5121: np.uint8, 5123: np.uint16, 5125: np.uint32, 5126: np.float32}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}


class Reader:
    """A glTF file as an engine computes it: nodes by their animation, meshes by their skins."""

    def __init__(self, path):
        self.file = GLTF2().load(str(path))
        self.binary = self.file.binary_blob()
        self.parents = {child: node for node, each in enumerate(self.file.nodes) for child in each.children or []}
        animation = self.file.animations[0]
        self.moved = {
            (channel.target.node, channel.target.path): self.array(animation.samplers[channel.sampler].output)
            for channel in animation.channels
        }
        self.times = self.array(animation.samplers[0].input)[:, 0]

    def array(self, index):
        accessor = self.file.accessors[index]
        width = WIDTHS[accessor.type]
        if accessor.bufferView is not None:
            return self.view(accessor.bufferView, accessor.componentType, accessor.count, width)
        values, sparse = np.zeros((accessor.count, width), TYPES[accessor.componentType]), accessor.sparse
        at = self.view(sparse.indices.bufferView, sparse.indices.componentType, sparse.count, 1)[:, 0]
        assert (np.diff(at.astype(int)) > 0).all(), "as the specification asks"
        values[at] = self.view(sparse.values.bufferView, accessor.componentType, sparse.count, width)
        return values

    def view(self, index, kind, count, width):
        start = self.file.bufferViews[index].byteOffset
        return np.frombuffer(self.binary, TYPES[kind], count * width, start).reshape(count, width)

    def world(self, node, frame):
        """(4, 4) of a node in a frame."""
        matrix = np.eye(4)
        if (node, "rotation") in self.moved:
            matrix[:3, :3] = Rotation.from_quat(self.moved[node, "rotation"][frame]).as_matrix()
        if (node, "scale") in self.moved:
            matrix[:3, :3] *= self.moved[node, "scale"][frame]
        if (node, "translation") in self.moved:
            matrix[:3, 3] = self.moved[node, "translation"][frame]
        return self.world(self.parents[node], frame) @ matrix if node in self.parents else matrix

    def attributes(self, name):
        """Accessors of a mesh, which all its primitives share."""
        return self.mesh(name).primitives[0].attributes

    def mesh(self, name):
        return next(mesh for mesh in self.file.meshes if mesh.name == name)

    def faces(self, name):
        """(f, 3) of all materials together."""
        return np.concatenate([self.array(part.indices).reshape(-1, 3) for part in self.mesh(name).primitives])

    def morphed(self, name, node, frame, attribute="POSITION"):
        """(v, 3) a mesh in a frame before it is skinned."""
        values = self.array(getattr(self.attributes(name), attribute)).astype(np.float64)
        targets = self.mesh(name).primitives[0].targets or []
        weights = self.moved.get((node, "weights"), np.zeros(0)).reshape(len(self.times), -1)[frame]
        assert len(weights) == len(targets)
        return values + sum(w * self.array(target[attribute]) for w, target in zip(weights, targets))

    def skinned(self, name, frame, attribute="POSITION"):
        """(v, 3) points of a mesh in a frame, in glTF's world, or its normals, not of unit length."""
        nodes = self.file.nodes
        place = next(k for k, node in enumerate(nodes) if node.name == name and node.mesh is not None)
        attributes = self.attributes(name)
        skin = self.file.skins[nodes[place].skin]
        bind = self.array(skin.inverseBindMatrices).reshape(-1, 4, 4).transpose(0, 2, 1)
        joints = np.array([self.world(joint, frame) for joint in skin.joints]) @ bind
        values = self.morphed(name, place, frame, attribute)
        points = np.pad(values, ((0, 0), (0, 1)), constant_values=float(attribute == "POSITION"))
        weights = self.array(attributes.WEIGHTS_0) / 65535
        each = np.einsum("vkij,vj->vki", joints[self.array(attributes.JOINTS_0)], points)
        return np.einsum("vk,vki->vi", weights, each)[:, :3]


def in_gltf_world(points, motion, frame):
    """Points of the root frame where glTF has them."""
    turned = Rotation.from_quat(motion.root_orientation[frame]).apply(points) + motion.root_position[frame]
    return turned @ FROM_ROOT_FRAME.T


def in_root_frame(points, motion, frame):
    """Points of glTF's world in the root frame."""
    world = points @ FROM_ROOT_FRAME - motion.root_position[frame]
    return np.ascontiguousarray(Rotation.from_quat(motion.root_orientation[frame]).inv().apply(world))


def skinned_layers(outfit):
    """(v, 3) [m] of each layer where its garment nodes have it in the last frame: without the order of layers, which no
    engine keeps."""
    clouds = [np.empty((layer.vertex_count, 3), dtype=np.float32) for layer in outfit.layers]
    for layer, nodes, offsets, cloud in zip(outfit.layers, outfit.node_transforms(), outfit.detail_offsets(), clouds):
        Skinner(layer.bound_visible).skin(nodes, cloud, offsets)
    return clouds
