"""For readers of garment nodes: 6 KB a frame instead of a cloud's 150, skinned where the garment is wanted.

    client = GarmentClient(node, lambda frame: draw(frame.points, frame.faces), topics="/drape_node")

Needs `physkin_msgs`. Dimensions: `n` vertices, `m` garment nodes, `f` faces. Metres, root frame of the avatar.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from physkin_msgs.msg import GarmentMesh, GarmentNodes
from rclpy.qos import DurabilityPolicy, QoSProfile

from physkin_core.model.skinning import SkinningData
from physkin_core.runtime.evaluator import Skinner
from physkin_ros.messages.topics import GARMENT_NODES, MESH

__all__ = ["GarmentClient", "GarmentFrame", "GarmentSkin"]


@dataclass(frozen=True)
class GarmentFrame:
    """A draped garment.

    points: (n, 6) float32 x, y, z [m] and unit normal, overwritten by the next frame. faces: (f, 3) uint32. header: of
    the joint state.
    """

    header: object
    points: np.ndarray
    faces: np.ndarray


class GarmentSkin:
    """Turns `physkin_msgs/GarmentNodes` into vertices. mesh: the `physkin_msgs/GarmentMesh` they are of.

    faces: (f, 3) uint32. points: (n, 6) float32 of the last frame. Raises ValueError when the mesh contradicts itself.
    """

    def __init__(self, mesh: GarmentMesh) -> None:
        counts = (mesh.vertex_count, mesh.node_count, mesh.influences)
        try:
            self.faces = np.array(mesh.faces, dtype=np.uint32).reshape(-1, 3)
            vertices, normals, node_rest = (
                np.array(values, dtype=np.float32).reshape(-1, 3)
                for values in (mesh.rest_vertices, mesh.rest_normals, mesh.node_rest)
            )
            influences = mesh.vertex_count, mesh.influences
            if (len(vertices), len(node_rest)) != (mesh.vertex_count, mesh.node_count):
                raise ValueError(f"{len(vertices)} vertices and {len(node_rest)} garment nodes")
            if self.faces.size and self.faces.max() >= mesh.vertex_count:
                raise ValueError(f"face index {self.faces.max()} of {mesh.vertex_count} vertices")
            skinning = SkinningData(
                node_rest=node_rest,
                vertices=vertices,
                normals=normals,
                influence_nodes=np.array(mesh.influence_nodes).astype(np.int32).reshape(influences),
                influence_weights=np.array(mesh.influence_weights, dtype=np.float32).reshape(influences),
            )
            self._skinner = Skinner(skinning)
        except ValueError as error:
            raise ValueError(
                f"garment mesh {mesh.model_name!r} (vertices, garment nodes, influences: {counts}): {error}"
            ) from error
        self.revision = mesh.revision
        self.points = np.empty((mesh.vertex_count, 6), dtype=np.float32)

    def skin(self, message: GarmentNodes) -> np.ndarray:
        """The points of a frame. Raises ValueError for garment nodes of another revision or number, or not finite."""
        if message.revision != self.revision:
            raise ValueError(f"garment nodes of revision {message.revision}, the mesh has revision {self.revision}")
        transforms = np.frombuffer(message.transforms, dtype=np.float32)
        if len(transforms) != 12 * self._skinner.node_count:
            raise ValueError(f"{len(transforms)} numbers for {self._skinner.node_count} garment nodes of 12 each")
        if not np.isfinite(transforms).all():
            raise ValueError("a garment node is not finite")
        self._skinner.skin(transforms.reshape(-1, 3, 4), self.points)
        return self.points


class GarmentClient:
    """Subscribes to a garment's mesh and garment nodes and calls `on_frame` with every frame it can skin.

    node: the reader's `rclpy.node.Node`. topics: what the garment's topics are below, such as "/drape_node" or
    "/drape_node/alice/top". Of an outfit, points are those of the clouds before they are moved to keep layers in order
    or hems tucked (`moved` in the mesh). skipped: frames without a mesh of their revision yet, or malformed ones.
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
            node.create_subscription(GarmentMesh, MESH.below(topics), self._on_mesh, latched),
            node.create_subscription(GarmentNodes, GARMENT_NODES.below(topics), self._on_nodes, depth),
        )

    def _on_mesh(self, message: GarmentMesh) -> None:
        try:
            self._skin = GarmentSkin(message)
        except ValueError as error:
            self._log.error(str(error))

    def _on_nodes(self, message: GarmentNodes) -> None:
        if self._skin is None or message.revision != self._skin.revision:
            self.skipped += 1
            return
        try:
            points = self._skin.skin(message)
        except ValueError as error:
            self.skipped += 1
            self._log.warning(f"garment nodes ignored: {error}", throttle_duration_sec=1.0)
            return
        self._on_frame(GarmentFrame(message.header, points, self._skin.faces))
