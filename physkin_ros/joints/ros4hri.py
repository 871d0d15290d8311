"""Joint states of ROS4HRI bodies (REP-155, the URDF of `human_description`) as joint positions of the default rig.

A joint map does not do here: from a limb that hangs down, a ROS4HRI shoulder turns about Z, X and Z (a hip: Z, X, Y);
from the A-pose, the rig's turns about X, Y and Z (a hip: Y, X, Z). So arms and legs are ball joints (`ball_joints`).
Radians, root frame (X forward, Y left, Z up).
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from physkin_core import Rig
from physkin_core.file_reading import shown
from physkin_core.rig.ball_joints import BallJoint
from physkin_ros.joints.joint_states import JointStateError, NamedJoints

__all__ = ["ROS4HRI", "Ros4hriNaming"]

ROS4HRI = "ros4hri"
"""What the parameter `joint_map` calls this translation."""

# A trunk joint is shared out among three of the rig's, all with the same axis.
SPINE = ("spine05", "spine03", "spine02")
NECK = ("neck01", "neck03", "head")
TRUNK = {"waist": (SPINE, "y", 1), "r_head": (NECK, "x", 1), "y_head": (NECK, "z", 1), "p_head": (NECK, "y", -1)}


class Ros4hriNaming:
    """The joint names of ROS4HRI bodies, with or without `_` and the body's id; the rig's own names mean themselves.

    Of a shoulder or hip, angles that are not named count as zero.
    Raises ValueError for a rig that lacks one of the default rig's joints.
    """

    def __init__(self, rig: Rig) -> None:
        self._own = frozenset(rig.joint_names)
        self._balls: dict[str, tuple[BallJoint, int]] = {}
        self._hinges: dict[str, list[tuple[str, float, float]]] = {}
        try:
            for side in ("L", "R"):
                for names, ball in (_arm(rig, side), _leg(rig, side)):
                    self._balls |= {name: (ball, slot) for slot, name in enumerate(names)}
                self._hinges |= {name: [entry] for name, entry in _hinges(rig, side).items()}
            for name, (bones, axis, sign) in TRUNK.items():
                joints = [f"{bone}_{axis}" for bone in bones]
                _indices(rig, joints)
                self._hinges[name] = [(joint, sign / len(bones), 0.0) for joint in joints]
        except ValueError as error:
            raise ValueError(f"joint_map {ROS4HRI} is for the default rig: {error}") from error
        known = sorted([*self._balls, *self._hinges], key=len, reverse=True)
        self._pattern = re.compile(rf"({'|'.join(known)})(?:_.*)?", re.DOTALL)

    def look_up(self, names: Sequence[str]) -> NamedJoints:
        """See `JointNaming`. Raises JointStateError for a ROS4HRI joint named twice (two bodies, say)."""
        found = NamedJoints()
        seen: set[str] = set()
        angles: dict[int, tuple[BallJoint, list[int]]] = {}
        for index, name in enumerate(names):
            match = self._pattern.fullmatch(name)
            if match is None:
                if name in self._own:
                    found.scaled.append((index, name, 1.0, 0.0))
                else:
                    found.unknown.append(index)
                continue
            known = match[1]
            if known in seen:
                raise JointStateError(f"joint {shown(name)} is the second {known!r}; a joint state holds one body")
            seen.add(known)
            if known in self._hinges:
                found.scaled += [(index, joint, scale, offset) for joint, scale, offset in self._hinges[known]]
            else:
                ball, slot = self._balls[known]
                angles.setdefault(id(ball), (ball, [-1, -1, -1]))[1][slot] = index
        found.balls = [(ball, tuple(sources)) for ball, sources in angles.values()]
        return found


def _arm(rig: Rig, side: str) -> tuple[list[str], BallJoint]:
    prefix, sign = side.lower(), (1.0 if side == "L" else -1.0)
    upper = _direction(rig, f"upperarm01.{side}", f"lowerarm01.{side}")
    (elbow,) = _indices(rig, [f"lowerarm01.{side}_z"])
    return [f"{prefix}_y_shoulder", f"{prefix}_p_shoulder", f"{prefix}_r_shoulder"], BallJoint(
        axes=np.array([[0, 0, -sign], [sign, 0, 0], [0, 0, sign]]),
        before=np.eye(3),
        after=_alignment(upper, rig.dof_axes[elbow], np.array([0, sign, 0])),  # the rig's T-pose elbow axis is Z
        frame=rig.dof_axes[_indices(rig, [f"upperarm01.{side}_{axis}" for axis in "xyz"])].T,
        joints=(*(f"upperarm01.{side}_{axis}" for axis in "xyz"), f"upperarm02.{side}_y"),
        twist=1,
    )


def _leg(rig: Rig, side: str) -> tuple[list[str], BallJoint]:
    prefix, sign = side.lower(), (1.0 if side == "L" else -1.0)
    thigh = _direction(rig, f"upperleg01.{side}", f"lowerleg01.{side}")
    return [f"{prefix}_y_hip", f"{prefix}_p_hip", f"{prefix}_r_hip"], BallJoint(
        axes=np.array([[0, 0, -1], [sign, 0, 0], [0, -1, 0]]),
        before=np.eye(3),
        after=_alignment(thigh, np.array([0.0, 1.0, 0.0]), np.array([0, 1, 0])),
        frame=rig.dof_axes[_indices(rig, [f"upperleg01.{side}_{axis}" for axis in "yxz"])].T,
        joints=(*(f"upperleg01.{side}_{axis}" for axis in "yxz"), f"upperleg02.{side}_z"),
        twist=2,
    )


def _hinges(rig: Rig, side: str) -> dict[str, tuple[str, float, float]]:
    """Elbow and knee: rig joint, scale and offset. ROS4HRI's zero is a straight limb, the rig's the A-pose."""
    sign = 1.0 if side == "L" else -1.0
    upper = _direction(rig, f"upperarm01.{side}", f"lowerarm01.{side}")
    lower = _direction(rig, f"lowerarm01.{side}", f"wrist.{side}")
    thigh = _direction(rig, f"upperleg01.{side}", f"lowerleg01.{side}")
    shin = _direction(rig, f"lowerleg01.{side}", f"foot.{side}")
    bent = np.arccos(np.clip(upper @ lower, -1, 1))
    knee = np.arctan2(thigh[0], -thigh[2]) - np.arctan2(shin[0], -shin[2])
    _indices(rig, [f"lowerleg01.{side}_y"])
    return {
        f"{side.lower()}_elbow": (f"lowerarm01.{side}_z", -sign, sign * bent),
        f"{side.lower()}_knee": (f"lowerleg01.{side}_y", -1.0, -knee),
    }


def _alignment(limb: np.ndarray, hinge: np.ndarray, hinge_at_zero: np.ndarray) -> np.ndarray:
    """Rotation (3, 3) that lets `limb` hang down and brings the part of `hinge` square to it to `hinge_at_zero`."""
    hinge = hinge - (hinge @ limb) * limb
    hinge = hinge / np.linalg.norm(hinge)
    down = np.array([0.0, 0.0, -1.0])
    before = np.stack([limb, hinge, np.cross(limb, hinge)], axis=1)
    after = np.stack([down, hinge_at_zero, np.cross(down, hinge_at_zero)], axis=1)
    return after @ before.T


def _direction(rig: Rig, start: str, end: str) -> np.ndarray:
    """Unit vector from one bone's head to another's at the canonical pose."""
    vector = rig.heads[rig.bone_index(end)] - rig.heads[rig.bone_index(start)]
    return vector / np.linalg.norm(vector)


def _indices(rig: Rig, joints: Sequence[str]) -> list[int]:
    return [rig.joint_names.index(joint) for joint in joints]
