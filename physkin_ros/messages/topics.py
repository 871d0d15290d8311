"""Every topic and service of the drape node, in one place: the usage text and the reference are made of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

__all__ = [
    "BONE_ROTATIONS",
    "DIAGNOSTICS",
    "DRAPED_JOINT_STATES",
    "EFFECTIVE_GRAVITY",
    "GARMENT",
    "GARMENT_NODES",
    "JOINT_STATES",
    "MARKER",
    "MESH",
    "SET_BODY",
    "SET_GARMENT",
    "SPLATS",
    "SPLAT_LOOK",
    "STATISTICS",
    "TOPICS",
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
    "x, y, z [m] and normal_x, normal_y, normal_z, float32, in the body's root frame; stamp of the joint state; "
    "never a value that is not finite",
)
SPLATS = Topic(
    "~/splats",
    "out",
    "sensor_msgs/PointCloud2",
    "the splats of points, draped, 28 bytes each, to readers only: x, y, z [m], float32; rot_x, rot_y, rot_z, "
    "rot_w, a unit quaternion, int16 in 1/32767; scale_0, scale_1, scale_2, int16, natural logarithms of standard "
    "deviations [m] in 1/1000",
    needs="points",
)
SPLAT_LOOK = Topic(
    "~/splat_look",
    "out",
    "sensor_msgs/PointCloud2",
    "what else the file says of each splat, under its names (opacity, f_dc_0, ...), in the same order; latched, once",
    needs="points",
)
MARKER = Topic("~/marker", "out", "visualization_msgs/Marker", "the garment's triangles, for RViz", needs="marker")
MESH = Topic(
    "~/mesh",
    "out",
    "physkin_msgs/GarmentMesh",
    "faces, rest vertices, skinning weights, detail, which vertices are given; latched, again when any of it changes",
)
GARMENT_NODES = Topic(
    "~/garment_nodes",
    "out",
    "physkin_msgs/GarmentNodes",
    "6 KB a frame instead of 90 to 150, for readers that skin by themselves, normals by the cofactors of the blend",
)
JOINT_STATES = Topic(
    "joint_states", "in", "sensor_msgs/JointState", "pose of the body: joints in any order [rad], some or all"
)
BONE_ROTATIONS = Topic(
    "bone_rotations",
    "in",
    "sensor_msgs/MultiDOFJointState",
    "pose of the body as rotations of bones, in place of joint states",
)
EFFECTIVE_GRAVITY = Topic(
    "~/effective_gravity",
    "in",
    "geometry_msgs/Vector3Stamped",
    "what an accelerated root feels: gravity less its acceleration [m/s2] in the body's root frame, zero in free "
    "fall, at most 29.4 long; takes gravity's place for 0.5 s",
)
DRAPED_JOINT_STATES = Topic(
    "~/joint_states",
    "out",
    "sensor_msgs/JointState",
    "joint positions that were draped [rad], for whoever draws the body; stamp of the joint state",
    needs="separate_limbs",
)
DIAGNOSTICS = Topic(
    "/diagnostics",
    "out",
    "diagnostic_msgs/DiagnosticArray",
    "once a second, as text: rates, rejections and why, times of the evaluation, how each garment sits",
)
STATISTICS = Topic("~/statistics", "out", "physkin_msgs/DrapeStatistics", "the same as numbers, once a second")
SET_BODY = Topic("~/set_body", "service", "physkin_msgs/SetBody", "another body while running")
SET_GARMENT = Topic("~/set_garment", "service", "physkin_msgs/SetGarment", "another garment while running")

TOPICS = (
    JOINT_STATES,
    BONE_ROTATIONS,
    Topic(
        "gravity",
        "in",
        "geometry_msgs/Vector3Stamped",
        "direction of gravity in the body's root frame, any length but zero; joint states are draped with the latest, "
        "so send it before them",
        needs="orientation: gravity",
    ),
    Topic(
        "pose",
        "in",
        "geometry_msgs/PoseStamped",
        "the body's root in an upright frame, in place of gravity; tells sway how it moves",
        needs="orientation: pose",
    ),
    Topic(
        "odometry",
        "in",
        "nav_msgs/Odometry",
        "as pose; twist and covariance are not read",
        needs="orientation: odometry",
    ),
    Topic("/tf", "in", "tf2_msgs/TFMessage", "as pose: the way from world_frame to frame_id", needs="orientation: tf"),
    Topic("/tf_static", "in", "tf2_msgs/TFMessage", "what of that way never changes", needs="orientation: tf"),
    Topic(
        "imu",
        "in",
        "sensor_msgs/Imu",
        "an IMU mounted like the root, in place of gravity: its orientation, or without one what it feels; and its "
        "linear acceleration (at rest 9.81 m/s2 up), smoothed, as effective gravity",
        needs="orientation: imu",
    ),
    EFFECTIVE_GRAVITY,
    GARMENT,
    DRAPED_JOINT_STATES,
    Topic("/tf", "out", "tf2_msgs/TFMessage", "frame_id in the frame of its pose, with its stamp", needs="publish_tf"),
    SPLATS,
    SPLAT_LOOK,
    MARKER,
    MESH,
    GARMENT_NODES,
    DIAGNOSTICS,
    STATISTICS,
    SET_BODY,
    SET_GARMENT,
)
"""With avatars, what is named without ~ is below the avatar's ID, and a garment's topics are below ~/ID/NAME."""
