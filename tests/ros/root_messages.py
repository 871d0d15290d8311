"""Stand-ins for messages about a root, which need no ROS."""

from __future__ import annotations

from types import SimpleNamespace as Message

UPRIGHT = (0.0, 0.0, 0.0, 1.0)


def vector(values):
    """A `Vector3` or `Point`."""
    return Message(x=values[0], y=values[1], z=values[2])


def turned(values):
    """A `Quaternion`."""
    return Message(x=values[0], y=values[1], z=values[2], w=values[3])


def header(seconds: float = 0.0, frame_id: str = ""):
    """A `Header`; the time to the nanosecond."""
    sec, nanosec = divmod(round(1e9 * seconds), 1_000_000_000)
    return Message(stamp=Message(sec=sec, nanosec=nanosec), frame_id=frame_id)


def pose(seconds: float, position, quaternion=UPRIGHT):
    """A `PoseStamped`."""
    return Message(header=header(seconds), pose=Message(position=vector(position), orientation=turned(quaternion)))


def odometry(seconds: float, position, quaternion=UPRIGHT):
    """An `Odometry`, of which the pose alone is filled."""
    stamped = pose(seconds, position, quaternion)
    return Message(header=stamped.header, pose=Message(pose=stamped.pose))


def imu(seconds: float, force, quaternion=None):
    """An `Imu`, without orientation by default."""
    return Message(
        header=header(seconds),
        orientation=turned(quaternion or UPRIGHT),
        orientation_covariance=[0.0 if quaternion else -1.0] + [0.0] * 8,
        linear_acceleration=vector(force),
        linear_acceleration_covariance=[0.0] * 9,
    )


def transform(parent: str, child: str, *, seconds: float = 0.0, place=(0.0, 0.0, 0.0), quaternion=UPRIGHT):
    """A `TransformStamped`."""
    return Message(
        header=header(seconds, parent),
        child_frame_id=child,
        transform=Message(translation=vector(place), rotation=turned(quaternion)),
    )
