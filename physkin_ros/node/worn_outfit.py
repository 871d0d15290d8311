"""What an avatar wears at the moment: an outfit, bound to the arrays that its frames are computed from.

Dimensions: `d` degrees of freedom, `g` garments. Radians.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property

import numpy as np

from physkin_core import FrameInput, LimbSeparator, Rig
from physkin_ros.joints.bone_rotation_message import BoneRotationReader
from physkin_ros.joints.joint_naming import load_naming
from physkin_ros.joints.joint_state_wire import JointStateWire
from physkin_ros.joints.joint_states import JointStateReader
from physkin_ros.joints.vrm_naming import VRM
from physkin_ros.node.asset_loading import LoadedWear
from physkin_ros.node.diagnostics import PoseRange
from physkin_ros.node.garment_stream import GarmentStream, LayerMessages
from physkin_ros.node.interpolation import PoseInterpolator
from physkin_ros.node.settings import AvatarSettings

__all__ = ["WornOutfit"]


class WornOutfit:
    """An outfit with the readers of messages for its rig, and the messages that its frames fill.

    streams: of the garments, from the skin outwards. frame_input: whose rows its frames read. before: what was worn
    until now. on_unknown, on_degrees, on_not_finite: as of `JointStateReader`.
    received: (d,) float32, the joint positions of the last message; only the readers write them. draped: (d,) float32,
    those that are draped. step: computes their frame into the garments' messages; raises ValueError when a result is
    not finite.
    Raises ValueError for a joint map that cannot be read.
    """

    def __init__(
        self,
        settings: AvatarSettings,
        loaded: LoadedWear,
        streams: Sequence[GarmentStream],
        frame_input: FrameInput,
        before: WornOutfit | None,
        *,
        on_unknown: Callable[[list[str]], None],
        on_degrees: Callable[[str, float], None],
        on_not_finite: Callable[[list[str]], None],
    ) -> None:
        self.outfit = loaded.outfit
        self._rig: Rig = loaded.outfit.layers[0].model.rig
        self._on_unknown, self._skeleton = on_unknown, "vrm" if settings.joint_map == VRM else "rig"
        self.reader = JointStateReader(
            self._rig.joint_names,
            self._rig.rest,
            naming=load_naming(settings.joint_map, self._rig),
            prefix=settings.joint_prefix,
            on_unknown=on_unknown,
            on_degrees=on_degrees,
            on_not_finite=on_not_finite,
        )
        self.received = self.reader.positions.copy()
        self.wire = JointStateWire(self.reader, self.received)
        self.range = PoseRange(self._rig, self.received)
        self.interpolator = PoseInterpolator(len(self.received), len(streams)) if settings.cloud_rate else None
        self.separator = None if loaded.limbs is None else LimbSeparator.from_bound(loaded.limbs)
        known = {each.stream: each for each in before.garments} if before is not None else {}
        self.garments = tuple(
            LayerMessages(stream, self.outfit, index, splats=loaded.splats, before=known.get(stream))
            for index, stream in enumerate(streams)
        )
        as_received = self.separator is None and self.interpolator is None
        self.draped = self.received if as_received else self.received.copy()
        self.step = self.outfit.bind_frame(self.draped, frame_input.rows, [each.points for each in self.garments])

    @cached_property
    def bone_rotations(self) -> BoneRotationReader:
        """Reads rotations of bones. Raises JointStateError for a rig that these are not for."""
        return BoneRotationReader(self._rig, self.reader, skeleton=self._skeleton, on_unknown=self._on_unknown)

    def carry_on(self, before: WornOutfit) -> None:
        """Keep the last good pose over a swap, where the rig is the same."""
        if before.reader.joint_names == self.reader.joint_names:
            self.reader.positions = before.reader.positions

    def accept_pose(self) -> None:
        """The pose received last is good: joints that later messages leave out stay in it."""
        self.wire.keep()

    def set_pose(self, positions: np.ndarray) -> float | None:
        """Set which joint positions (d,) are draped next, limbs separated where that is asked for. Returns how far
        limbs were moved apart [rad], None without separation."""
        if self.separator is not None:
            return self.separator.separate(positions, out=self.draped)[1]
        if positions is not self.draped:
            self.draped[:] = positions
        return None
