"""Joint states of ROS4HRI bodies (REP-155, the URDF of `human_description`) as joint positions of the default rig.

A joint map does not do here: from a limb that hangs down, a ROS4HRI shoulder turns about Z, X and Z (a hip: Z, X, Y);
from the A-pose, the rig's turns about X, Y and Z (a hip: Y, X, Z). So a limb's three angles are composed to a rotation,
which is then taken apart anew.
Radians, root frame (X forward, Y left, Z up).
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from physkin_core import Rig
from physkin_ros.conversions import JointStateError

__all__ = ["ROS4HRI", "Ros4hriReader"]

ROS4HRI = "ros4hri"
"""What the parameter `joint_map` calls this translation."""

# A trunk joint is shared out among three of the rig's, all with the same axis.
SPINE = ("spine05", "spine03", "spine02")
NECK = ("neck01", "neck03", "head")
TRUNK = {"waist": (SPINE, "y", 1), "r_head": (NECK, "x", 1), "y_head": (NECK, "z", 1), "p_head": (NECK, "y", -1)}


class _Limb:
    """An arm or leg: three ROS4HRI angles to four of the rig, the ball joint's and the second half of the twist."""

    def __init__(self, rig: Rig, names: Sequence[str], axes: np.ndarray, joints: Sequence[str], aligned: np.ndarray):
        """names, axes (3, 3): ROS4HRI joints, outermost first. joints: the rig's; the last one is the second half.

        aligned: rotation of the limb from the canonical pose to where ROS4HRI has its zero.
        """
        self.names, self.joints, self._axes, self._aligned = tuple(names), tuple(joints), axes, aligned
        self._order = "".join(name[-1] for name in joints[:3]).upper()
        by_letter = {name[-1]: rig.dof_axes[rig.joint_names.index(name)] for name in joints[:3]}
        self._frame = np.stack([by_letter[letter] for letter in "xyz"], axis=1)
        self._twist = joints[3][-1].upper()

    def translate(self, angles: np.ndarray) -> np.ndarray:
        """Rig positions (4,) [rad] for ROS4HRI angles (3,) [rad]."""
        hanging = Rotation.from_rotvec(self._axes[0] * angles[0])
        for axis, angle in zip(self._axes[1:], angles[1:]):
            hanging = hanging * Rotation.from_rotvec(axis * angle)
        turn = Rotation.from_matrix(self._frame.T @ hanging.as_matrix() @ self._aligned @ self._frame)
        with warnings.catch_warnings():  # where two axes coincide, any split between them is right
            warnings.simplefilter("ignore", UserWarning)
            half = turn.as_euler(self._order)[self._order.index(self._twist)] / 2
            first = (turn * Rotation.from_euler(self._twist, -half)).as_euler(self._order)
        return np.append(first, half)


class Ros4hriReader:
    """Gives the joints of one ROS4HRI body the names and positions of the default rig.

    Raises ValueError for a rig that lacks one of the default rig's joints.
    """

    def __init__(self, rig: Rig) -> None:
        try:
            self._limbs = [limb for side in ("L", "R") for limb in (_arm(rig, side), _leg(rig, side))]
            self._hinges = {name: entry for side in ("L", "R") for name, entry in _hinges(rig, side).items()}
            for bones, axis, _ in TRUNK.values():
                _indices(rig, [f"{bone}_{axis}" for bone in bones])
        except ValueError as error:
            raise ValueError(f"joint_map {ROS4HRI} is for the default rig: {error}") from error
        self._known = {name for limb in self._limbs for name in limb.names} | set(self._hinges) | set(TRUNK)

    def translate(self, names: Sequence[str], values: Sequence[float]) -> tuple[list[str], list[float]]:
        """Rig joints and their positions [rad] for name and position of a joint state; other joints stay as they are.

        Names may end in `_` and the body's id. Of a shoulder or hip, angles that are not named count as zero.
        Raises JointStateError for a ROS4HRI joint named twice (two bodies, say) or with a value that is not finite.
        """
        if len(names) != len(values):
            return list(names), list(values)  # the reader of joint states says what is wrong
        given: dict[str, float] = {}
        other = []
        for name, value in zip(names, values):
            known = self._without_id(name)
            if known is None:
                other.append((name, value))
            elif known in given:
                raise JointStateError(f"joint {name!r} is the second {known!r}; a joint state holds one body")
            elif not np.isfinite(value):
                raise JointStateError(f"the position of joint {name!r} is {value}; it must be finite [rad]")
            else:
                given[known] = value
        positions = dict(other)
        for limb in self._limbs:
            if not given.keys().isdisjoint(limb.names):
                angles = np.array([given.get(name, 0.0) for name in limb.names])
                positions |= dict(zip(limb.joints, limb.translate(angles).tolist()))
        for name, (joint, scale, offset) in self._hinges.items():
            if name in given:
                positions[joint] = scale * given[name] + offset
        for name, (bones, axis, sign) in TRUNK.items():
            if name in given:
                positions |= {f"{bone}_{axis}": sign * given[name] / len(bones) for bone in bones}
        return list(positions), list(positions.values())

    def _without_id(self, name: str) -> str | None:
        """The ROS4HRI joint, or None."""
        return next((known for known in self._known if name == known or name.startswith(f"{known}_")), None)


def _arm(rig: Rig, side: str) -> _Limb:
    prefix, sign = side.lower(), (1.0 if side == "L" else -1.0)
    upper = _direction(rig, f"upperarm01.{side}", f"lowerarm01.{side}")
    (elbow,) = _indices(rig, [f"lowerarm01.{side}_z"])
    return _Limb(
        rig,
        [f"{prefix}_y_shoulder", f"{prefix}_p_shoulder", f"{prefix}_r_shoulder"],
        np.array([[0, 0, -sign], [sign, 0, 0], [0, 0, sign]]),
        [f"upperarm01.{side}_x", f"upperarm01.{side}_y", f"upperarm01.{side}_z", f"upperarm02.{side}_y"],
        _alignment(upper, rig.dof_axes[elbow], np.array([0, sign, 0])),  # the rig's T-pose elbow axis is Z
    )


def _leg(rig: Rig, side: str) -> _Limb:
    prefix, sign = side.lower(), (1.0 if side == "L" else -1.0)
    thigh = _direction(rig, f"upperleg01.{side}", f"lowerleg01.{side}")
    return _Limb(
        rig,
        [f"{prefix}_y_hip", f"{prefix}_p_hip", f"{prefix}_r_hip"],
        np.array([[0, 0, -1], [sign, 0, 0], [0, -1, 0]]),
        [f"upperleg01.{side}_y", f"upperleg01.{side}_x", f"upperleg01.{side}_z", f"upperleg02.{side}_z"],
        _alignment(thigh, np.array([0.0, 1.0, 0.0]), np.array([0, 1, 0])),
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
