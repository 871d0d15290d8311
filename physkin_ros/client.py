"""For readers that skin garment nodes themselves: 18.5 KB a frame instead of a cloud of 140.

    client = GarmentClient(node, lambda frame: draw(frame.points, frame.faces), topics="/drape_node")

Needs `physkin_msgs`. Dimensions: `n` vertices, `m` garment nodes, `f` faces. Metres, root frame of the avatar.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from physkin_msgs.msg import GarmentMesh, GarmentNodes
from rclpy.qos import DurabilityPolicy, QoSProfile

from physkin_core.file_reading import sentence, shown
from physkin_core.model.skinning import SkinningData
from physkin_core.runtime.evaluator import Skinner
from physkin_ros.messages.serialised import read_serialised
from physkin_ros.messages.topics import GARMENT_NODES, MESH

__all__ = ["GarmentClient", "GarmentFrame", "GarmentSkin"]


@dataclass(frozen=True)
class GarmentFrame:
    """A draped garment.

    Attributes:
        header: of the joint state.
        points: (n, 6) float32 x, y, z [m] and unit normal; overwritten by the next frame.
        faces: (f, 3) uint32.
    """

    header: object
    points: np.ndarray
    faces: np.ndarray


class GarmentSkin:
    """Turns `physkin_msgs/GarmentNodes` into vertices.

    Args:
        mesh: the `physkin_msgs/GarmentMesh` that they belong to.

    Attributes:
        faces: (f, 3) uint32.
        points: (n, 6) float32 of the last frame.

    Raises:
        ValueError: if the mesh contradicts itself.

    Examples:
        >>> skin = GarmentSkin(mesh)  # from ~/mesh
        >>> points = skin.skin(message)  # from ~/garment_nodes
    """

    def __init__(self, mesh: GarmentMesh) -> None:
        try:
            self.faces = np.array(mesh.faces, dtype=np.uint32).reshape(-1, 3)
            if self.faces.size and self.faces.max() >= mesh.vertex_count:
                raise ValueError(f"face index {self.faces.max()} of {mesh.vertex_count} vertices")
            self._skinner = Skinner(_skinning_data(mesh))
        except ValueError as error:
            raise ValueError(f"garment mesh {shown(mesh.model_name)}: {error}") from error
        self.revision, self.detail_node_count = mesh.revision, mesh.detail_node_count
        self.points = np.empty((mesh.vertex_count, 6), dtype=np.float32)

    def skin(self, message: GarmentNodes) -> np.ndarray:
        """Skin one frame.

        Args:
            message: a `physkin_msgs/GarmentNodes`.

        Returns:
            (n, 6) float32 x, y, z [m] and unit normal, overwritten by the next frame.

        Raises:
            ValueError: for garment nodes of another revision or number, or that are not finite.
        """
        if message.revision != self.revision:
            raise ValueError(f"garment nodes of revision {message.revision}, the mesh has revision {self.revision}")
        transforms, offsets = (
            np.frombuffer(values, dtype=np.float32) for values in (message.transforms, message.detail_offsets)
        )
        if len(transforms) != 12 * self._skinner.node_count:
            raise ValueError(f"{len(transforms)} numbers for {self._skinner.node_count} garment nodes of 12 each")
        if len(offsets) != 3 * self.detail_node_count:
            raise ValueError(f"{len(offsets)} numbers for {self.detail_node_count} detail nodes of 3 each")
        if not (np.isfinite(transforms).all() and np.isfinite(offsets).all()):
            raise ValueError("a garment node or detail node is not finite")
        self._skinner.skin(transforms.reshape(-1, 3, 4), self.points, offsets.reshape(-1, 3))
        return self.points


def _skinning_data(mesh: GarmentMesh) -> SkinningData:
    """What skinning needs of a mesh. Raises ValueError for an array of another length than its counts say."""

    def values(name: str, *shape: int, dtype: type = np.float32) -> np.ndarray:
        given = np.array(getattr(mesh, name))
        if len(given) != math.prod(shape):
            raise ValueError(f"{name} has {len(given)} numbers; allowed: {' * '.join(map(str, shape))}")
        return given.astype(dtype).reshape(shape)

    vertices, nodes, detail = mesh.vertex_count, mesh.node_count, mesh.detail_node_count
    return SkinningData(
        node_rest=values("node_rest", nodes, 3),
        vertices=values("rest_vertices", vertices, 3),
        normals=values("rest_normals", vertices, 3),
        influence_nodes=values("influence_nodes", vertices, mesh.influences, dtype=np.int32),
        influence_weights=values("influence_weights", vertices, mesh.influences),
        faces=np.array(mesh.faces, dtype=np.int32).reshape(-1, 3),
        detail_node_count=detail,
        detail_nodes=values("detail_nodes", vertices if detail else 0, mesh.detail_influences, dtype=np.int32),
        detail_weights=values("detail_weights", vertices if detail else 0, mesh.detail_influences),
    )


class GarmentClient:
    """Subscribes to the mesh and the garment nodes of a garment, and calls a function with every frame.

    For a garment of an outfit, points are those of the clouds before layers and tucked hems are put in order (`moved`
    in the mesh).

    Args:
        node: the reader's `rclpy.node.Node`.
        on_frame: called with each `GarmentFrame`.
        topics: the name that the garment's topics begin with, such as "/drape_node" or "/drape_node/alice/top".
        depth: of the queue of garment nodes.

    Attributes:
        skipped: number of frames that were malformed, or came before the mesh of their revision.

    Examples:
        >>> client = GarmentClient(node, lambda frame: print(frame.points.shape), topics="/drape_node")
        >>> rclpy.spin(node)
    """

    def __init__(
        self, node, on_frame: Callable[[GarmentFrame], None], *, topics: str = "/drape_node", depth: int = 5
    ) -> None:
        self.skipped = 0
        self._on_frame = on_frame
        self._skin: GarmentSkin | None = None
        self._log = node.get_logger()
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._subscriptions = (
            node.create_subscription(GarmentMesh, MESH.below(topics), self._on_mesh, latched, raw=True),
            node.create_subscription(GarmentNodes, GARMENT_NODES.below(topics), self._on_nodes, depth, raw=True),
        )

    def _on_mesh(self, data: bytes) -> None:
        try:
            self._skin = GarmentSkin(read_serialised(data, GarmentMesh))
        except ValueError as error:
            self._log.error(sentence(str(error)))

    def _on_nodes(self, data: bytes) -> None:
        try:
            message = read_serialised(data, GarmentNodes)
            if self._skin is None or message.revision != self._skin.revision:
                self.skipped += 1
                return
            points = self._skin.skin(message)
        except ValueError as error:
            self.skipped += 1
            self._log.warning(f"garment nodes ignored: {error}", throttle_duration_sec=1.0)
            return
        self._on_frame(GarmentFrame(message.header, points, self._skin.faces))
