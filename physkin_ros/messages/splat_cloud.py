"""Gaussian splats as point clouds: what moves in a few bytes every frame, what does not once.

Dimensions: `n` splats.
"""

from __future__ import annotations

import numpy as np

from physkin_core import Splats
from physkin_ros.messages.point_cloud import cloud_fields, point_cloud
from physkin_ros.messages.serialised import SerialisedMessage

__all__ = ["SPLAT", "SplatCloud", "read_splats", "splat_attributes"]

TURN, LOGARITHM = 32767, 1000
"""What a quaternion's numbers and the natural logarithms of scales are multiplied by: 0.002 degrees and 0.05 % lost."""
SPLAT = np.dtype(
    {
        "names": ("x", "y", "z", "rot_x", "rot_y", "rot_z", "rot_w", "scale_0", "scale_1", "scale_2"),
        "formats": ("f4", "f4", "f4", *["i2"] * 7),
        "offsets": (0, 4, 8, 12, 14, 16, 18, 20, 22, 24),
        "itemsize": 28,
    }
)
"""A splat in the message."""
PLACE, ROTATION, SCALE = SPLAT.names[:3], SPLAT.names[3:7], SPLAT.names[7:]


class SplatCloud:
    """One `sensor_msgs/PointCloud2` of splats, filled in place and published again and again."""

    def __init__(self, count: int, frame_id: str) -> None:
        kept = SerialisedMessage(lambda data: point_cloud(SPLAT, count, data, frame_id), (count,), dtype=SPLAT)
        (self._splats,), self.publish = kept.payloads, kept.publish

    def fill(self, splats: Splats) -> None:
        """Let it hold these."""
        turns = np.rint(TURN * splats.rotations)
        logarithms = np.clip(np.rint(LOGARITHM * np.log(splats.scales)), -TURN, TURN)
        for names, values in ((PLACE, splats.centres), (ROTATION, turns), (SCALE, logarithms)):
            for column, name in enumerate(names):
                self._splats[name] = values[:, column]


def read_splats(message) -> Splats:
    """The splats of a message, in its frame. Raises ValueError when it is not laid out as `SplatCloud`."""
    fields = [(field.name, field.offset, field.datatype, field.count) for field in message.fields]
    expected = [(field.name, field.offset, field.datatype, field.count) for field in cloud_fields(SPLAT)]
    size = SPLAT.itemsize * message.width
    if fields != expected or message.point_step != SPLAT.itemsize or len(message.data) != size:
        raise ValueError(f"no splats: fields {fields}, {len(message.data)} bytes; expected {expected}, {size} bytes")
    splats = np.frombuffer(message.data, dtype=SPLAT)
    place, rotation, scale = (np.stack([splats[name] for name in names], 1) for names in (PLACE, ROTATION, SCALE))
    return Splats(place, rotation.astype(np.float32), np.exp(scale / np.float32(LOGARITHM)))


def splat_attributes(look: np.ndarray, frame_id: str):
    """The `sensor_msgs/PointCloud2` of what is known of splats besides, (n,) records; the stamp is the caller's."""
    native = np.dtype([(name, look.dtype[name].newbyteorder("=")) for name in look.dtype.names])
    return point_cloud(native, len(look), look.astype(native).tobytes(), frame_id)
