"""Every topic and service of the drape node, in one place: the usage text and the reference are made of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

__all__ = [
    "BONE_ROTATIONS",
    "DIAGNOSTICS",
    "DRAPED_JOINT_STATES",
    "GARMENT",
    "GARMENT_NODES",
    "GRAVITY",
    "IMU",
    "JOINT_STATES",
    "MARKER",
    "MESH",
    "ODOMETRY",
    "SET_BODY",
    "SET_GARMENT",
    "SPLATS",
    "SPLAT_ATTRIBUTES",
    "STATISTICS",
    "TOPICS",
    "WIND",
    "Topic",
]


@dataclass(frozen=True)
class Topic:
    """One of them. name: by default, with one avatar. type: package/Type. needs: parameter that opens it, if any."""

    name: str
    direction: Literal["in", "out", "service"]
    type: str
    description: str
    needs: str = ""

    def of(self, avatar: str) -> str:
        """Its name for one of several avatars, by id; empty for the only one."""
        if not avatar or self.name.startswith("/"):
            return self.name
        return self.below(f"~/{avatar}") if self.name.startswith("~") else f"{avatar}/{self.name}"

    def below(self, place: str) -> str:
        """Its name where "~" is another place, such as "~/alice/top"."""
        return self.name.replace("~", place, 1)


GARMENT = Topic(
    "~/garment",
    "out",
    "sensor_msgs/PointCloud2",
    "cloth: x, y, z [m] and normal_x, normal_y, normal_z of each vertex, float32, always finite",
)
SPLATS = Topic(
    "~/splats",
    "out",
    "sensor_msgs/PointCloud2",
    "draped Gaussian splats, 28 bytes each, while the topic has subscribers. x, y, z: float32 [m]. rot_x, rot_y, "
    "rot_z, rot_w: a unit quaternion, int16 in units of 1/32767. scale_0, scale_1, scale_2: natural logarithms of "
    "standard deviations [m], int16 in units of 1/1000",
    needs="splats",
)
SPLAT_ATTRIBUTES = Topic(
    "~/splat_attributes",
    "out",
    "sensor_msgs/PointCloud2",
    "the file's other values of each splat, under its own names (opacity, f_dc_0, ...). Latched",
    needs="splats",
)
MARKER = Topic(
    "~/marker", "out", "visualization_msgs/Marker", "the garment's triangles, for RViz, while the topic has subscribers"
)
MESH = Topic(
    "~/mesh",
    "out",
    "physkin_msgs/GarmentMesh",
    "what stays the same from frame to frame, such as triangles. Latched, and sent again when it changes",
)
GARMENT_NODES = Topic(
    "~/garment_nodes",
    "out",
    "physkin_msgs/GarmentNodes",
    "the garment nodes of a frame, for readers that skin the cloth themselves",
)
JOINT_STATES = Topic(
    "joint_states",
    "in",
    "sensor_msgs/JointState",
    "all or some joints by name, in any order [rad]",
)
BONE_ROTATIONS = Topic(
    "bone_rotations",
    "in",
    "sensor_msgs/MultiDOFJointState",
    "rotations of bones, instead of joint states",
)
GRAVITY = Topic(
    "gravity",
    "in",
    "geometry_msgs/Vector3Stamped",
    "direction of gravity in the root frame, of any length but zero. Send it before its joint state",
    needs="orientation: gravity",
)
ODOMETRY = Topic(
    "odometry",
    "in",
    "nav_msgs/Odometry",
    "where the root is, in a frame whose Z is up. Twist and covariance are not read",
    needs="orientation: odometry",
)
IMU = Topic(
    "imu",
    "in",
    "sensor_msgs/Imu",
    "an IMU with the axes of the root. Its orientation gives gravity; its linear acceleration (at rest 9.81 m/s2 "
    "upwards) lets cloth sway. Without an orientation, the acceleration gives both",
    needs="orientation: imu",
)
WIND = Topic(
    "~/wind",
    "in",
    "geometry_msgs/Vector3Stamped",
    "velocity of the air around all avatars, at most 13 m/s, in the world (Z up), whatever frame its header names",
)
DRAPED_JOINT_STATES = Topic(
    "~/joint_states",
    "out",
    "sensor_msgs/JointState",
    "the joint positions that were draped [rad], for drawing the body",
    needs="separate_limbs",
)
DIAGNOSTICS = Topic(
    "/diagnostics",
    "out",
    "diagnostic_msgs/DiagnosticArray",
    "once a second: rates, times, what was refused and why, how much of each garment is inside the body at rest",
)
STATISTICS = Topic("~/statistics", "out", "physkin_msgs/DrapeStatistics", "rates, times and counts as numbers")
SET_BODY = Topic("~/set_body", "service", "physkin_msgs/SetBody", "puts another body under the garments")
SET_GARMENT = Topic("~/set_garment", "service", "physkin_msgs/SetGarment", "puts another garment on")

TOPICS = (
    JOINT_STATES,
    BONE_ROTATIONS,
    GRAVITY,
    ODOMETRY,
    Topic(
        "/tf",
        "in",
        "tf2_msgs/TFMessage",
        "the same as odometry, from world_frame to frame_id",
        needs="orientation: tf",
    ),
    Topic(
        "/tf_static",
        "in",
        "tf2_msgs/TFMessage",
        "the transforms of /tf that never change",
        needs="orientation: tf",
    ),
    IMU,
    WIND,
    GARMENT,
    DRAPED_JOINT_STATES,
    SPLATS,
    SPLAT_ATTRIBUTES,
    MARKER,
    MESH,
    GARMENT_NODES,
    DIAGNOSTICS,
    STATISTICS,
    SET_BODY,
    SET_GARMENT,
)
"""With avatars, what is named without ~ is below the avatar's ID, and a garment's topics are below ~/ID/NAME."""
