"""Unit quaternions x, y, z, w of single messages, as plain numbers: arrays of four would cost more than they bring."""

from __future__ import annotations

import math
from collections.abc import Sequence

__all__ = [
    "OrientationError",
    "Quaternion",
    "Vector",
    "between",
    "inverse",
    "product",
    "quaternion_of",
    "rotated",
    "unit_quaternion",
    "vector_of",
]

Quaternion = tuple[float, float, float, float]
Vector = tuple[float, float, float]


class OrientationError(ValueError):
    """A message does not say how the root is turned or where it is; the text says why."""


def vector_of(message) -> Vector:
    """The numbers of a `geometry_msgs/Vector3` or `Point`."""
    return message.x, message.y, message.z


def quaternion_of(message) -> Quaternion:
    """The numbers of a `geometry_msgs/Quaternion`."""
    return message.x, message.y, message.z, message.w


def unit_quaternion(quaternion: Sequence[float]) -> Quaternion:
    """The same at length 1. Raises OrientationError for what is no rotation: far from that length, or not finite."""
    x, y, z, w = quaternion
    square = x * x + y * y + z * z + w * w
    if not (math.isfinite(square) and abs(square - 1.0) < 0.1):
        raise OrientationError(f"orientation is {[x, y, z, w]}; it must be a unit quaternion x, y, z, w")
    length = math.sqrt(square)
    return x / length, y / length, z / length, w / length


def inverse(turn: Quaternion) -> Quaternion:
    """The way back."""
    x, y, z, w = turn
    return -x, -y, -z, w


def product(a: Quaternion, b: Quaternion) -> Quaternion:
    """`b`, then `a`."""
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )


def rotated(turn: Quaternion, vector: Sequence[float]) -> Vector:
    """A vector, turned."""
    x, y, z, _ = product(product(turn, (*vector, 0.0)), inverse(turn))
    return x, y, z


def between(a: Quaternion, b: Quaternion, share: float) -> Quaternion:
    """From `a` to `b` the short way, by a share of it; for turns as small as those between two messages."""
    sign = -1.0 if sum(p * q for p, q in zip(a, b)) < 0 else 1.0
    mixed = [p + share * (sign * q - p) for p, q in zip(a, b)]
    length = math.sqrt(sum(value * value for value in mixed))
    return a if length < 1e-6 else tuple(value / length for value in mixed)
