"""Rig: bones and named scalar degrees of freedom; joint positions -> bone transforms.

Dimensions: `b` bones, `d` scalar degrees of freedom, `p = d + 3` pose vector. Angles in radians, lengths in metres,
everything in the avatar's root frame (REP-103: X forward, Y left, Z up). The paper's linear map from theta to joint
state (paper: Inputs) is the list of degrees of freedom: each turns one bone about one fixed axis.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from difflib import get_close_matches
from functools import cached_property
from typing import Any

import numpy as np

from physkin_core.file_reading import listed, shown

__all__ = ["MOST_BONES", "DegreeOfFreedom", "Rig", "RigError", "ancestors", "forward_kinematics", "pose_vector"]


MOST_BONES, MOST_DOFS = 2_048, 6_144
"""Far beyond what characters have."""


class RigError(ValueError):
    """A rig description is inconsistent, or does not match what it is used with."""


@dataclass(frozen=True)
class DegreeOfFreedom:
    """One joint: a named rotation of one bone about one axis, which `sensor_msgs/JointState` carries as a number.

    Attributes:
        name: of the joint.
        bone: the bone that it turns.
        axis: (3,) unit vector in the root frame, in the canonical pose.
        lower, upper: limits [rad].
        rest: position in the canonical pose [rad]; the bone turns by `position - rest`.

    Examples:
        >>> elbow = next(dof for dof in physkin.load_garment_model("tshirt").rig.dofs if dof.name == "lowerarm01.L_z")
        >>> elbow.bone, elbow.lower < elbow.upper
        ('lowerarm01.L', True)
    """

    name: str
    bone: str
    axis: tuple[float, float, float]
    lower: float
    upper: float
    rest: float = 0.0


@dataclass(frozen=True)
class Rig:
    """A skeleton in canonical pose, and its joints.

    Attributes:
        bone_names: (b,), a parent before its children.
        parents: (b,) int32, -1 for the root (bone 0).
        heads, tails: (b, 3) [m] joint centre and far end of each bone in the canonical pose, root frame.
        dofs: the joints. Several on one bone are applied in the order of the list (intrinsic rotations).

    Examples:
        >>> rig = physkin.load_garment_model("tshirt").rig
        >>> rig.bone_transforms(rig.joint_positions({"lowerarm01.L_z": -1.0})).shape
        (36, 3, 4)
    """

    bone_names: tuple[str, ...]
    parents: np.ndarray
    heads: np.ndarray
    tails: np.ndarray
    dofs: tuple[DegreeOfFreedom, ...]
    dof_bones: np.ndarray = field(init=False, repr=False)
    dof_axes: np.ndarray = field(init=False, repr=False)
    lower: np.ndarray = field(init=False, repr=False)
    upper: np.ndarray = field(init=False, repr=False)
    rest: np.ndarray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Check the description and derive the arrays. Raises RigError naming what does not fit."""
        b = len(self.bone_names)
        if not 0 < b <= MOST_BONES:
            raise RigError(f"a rig needs 1 to {MOST_BONES} bones, got {b}")
        if len(self.dofs) > MOST_DOFS:
            raise RigError(f"a rig has at most {MOST_DOFS} degrees of freedom, got {len(self.dofs)}")
        _reject_duplicates("bone", self.bone_names)
        _reject_duplicates("degree of freedom", [dof.name for dof in self.dofs])
        parents = np.asarray(self.parents)
        heads = np.ascontiguousarray(self.heads, dtype=np.float64)
        tails = np.ascontiguousarray(self.tails, dtype=np.float64)
        if parents.shape != (b,) or heads.shape != (b, 3) or tails.shape != (b, 3):
            raise RigError(
                f"rig of {b} bones: parents {parents.shape}, heads {heads.shape}, tails {tails.shape}; "
                f"expected ({b},), ({b}, 3), ({b}, 3)"
            )
        if parents.dtype.kind not in "iu":
            raise RigError(f"parents must be integer bone indices, -1 for the root, got {shown(parents.tolist())}")
        if not (np.isfinite(heads).all() and np.isfinite(tails).all()):
            raise RigError("bone heads and tails must be finite")
        if parents[0] != -1:
            raise RigError(f"bone 0 ({shown(self.bone_names[0])}) must be the root with parent -1, got {parents[0]}")
        for index in range(1, b):
            if not 0 <= parents[index] < index:
                name = shown(self.bone_names[index])
                raise RigError(f"bone {name} has parent {parents[index]}; a parent must come before its child")
        bone_index = {name: index for index, name in enumerate(self.bone_names)}
        for dof in self.dofs:
            _check_dof(dof, bone_index)
        numbers = np.array([[d.lower, d.upper, d.rest] for d in self.dofs], dtype=np.float64).reshape(-1, 3)
        axes = np.array([d.axis for d in self.dofs], dtype=np.float64).reshape(-1, 3)
        derived = {
            "parents": np.array(parents, dtype=np.int32),
            "heads": heads,
            "tails": tails,
            "dof_bones": np.array([bone_index[d.bone] for d in self.dofs], dtype=np.int32),
            "dof_axes": axes / np.linalg.norm(axes, axis=1, keepdims=True),
            "lower": numbers[:, 0].copy(),
            "upper": numbers[:, 1].copy(),
            "rest": numbers[:, 2].copy(),
        }
        for name, array in derived.items():
            array.flags.writeable = False
            object.__setattr__(self, name, array)

    @property
    def bone_count(self) -> int:
        """Number of bones b."""
        return len(self.bone_names)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """(d,) names of the joints, in the order of joint positions."""
        return tuple(dof.name for dof in self.dofs)

    @cached_property
    def joint_indices(self) -> dict[str, int]:
        """The index of each joint in the order of joint positions, by its name."""
        return {name: index for index, name in enumerate(self.joint_names)}

    @property
    def pose_size(self) -> int:
        """Length p of the pose vector: one number for each joint, then the direction of gravity."""
        return len(self.dofs) + 3

    def bone_index(self, name: str) -> int:
        """Index of a bone by name. Raises RigError when there is none."""
        try:
            return self.bone_names.index(name)
        except ValueError:
            raise RigError(f"no bone {name!r} in this rig; bones are {', '.join(self.bone_names)}") from None

    def joint_positions(self, mapping: Mapping[str, float], *, start: np.ndarray | None = None) -> np.ndarray:
        """Joint positions in this rig's order.

        Args:
            mapping: positions [rad] by joint name.
            start: (d,) positions of the joints that are left out. None: at rest.

        Returns:
            (d,) [rad].

        Raises:
            RigError: for an unknown joint. It suggests similar names and says where all names are listed.
        """
        positions = np.array(self.rest if start is None else start, dtype=np.float64)
        if positions.shape != (len(self.dofs),):
            raise RigError(f"start has shape {positions.shape}, expected ({len(self.dofs)},)")
        index = self.joint_indices
        for name, value in mapping.items():
            if name not in index:
                close = ", ".join(get_close_matches(str(name), self.joint_names, cutoff=0.4))
                raise RigError(
                    f"no joint {name!r} in this rig{f'; did you mean {close}?' if close else '.'} "
                    f"`physkin info MODEL` lists its {len(self.dofs)} joints, as does `Draper.joint_names`"
                )
            positions[index[name]] = value
        return positions

    def bone_transforms(self, joint_positions: np.ndarray, *, heads: np.ndarray | None = None) -> np.ndarray:
        """Forward kinematics: the transform of each bone from the canonical to the posed state.

        Args:
            joint_positions: (..., d) [rad].
            heads: (b, 3) [m] joint centres of another body. None: this rig's.

        Returns:
            (..., b, 3, 4) matrices [R | t] that map canonical points to posed points, both in the root frame.
        """
        q = np.asarray(joint_positions, dtype=np.float64)
        if q.shape[-1:] != (len(self.dofs),):
            raise RigError(f"joint positions have shape {q.shape}; the last axis must be {len(self.dofs)}")
        heads = self.heads if heads is None else np.asarray(heads, dtype=np.float64)
        return forward_kinematics(self.parents, heads, self.dof_bones, self.dof_axes, q - self.rest)

    @cached_property
    def turns_with(self) -> np.ndarray:
        """(b,) for each bone, itself or its nearest ancestor that has joints. Bones that share it turn together."""
        return self.inherited({int(bone): int(bone) for bone in self.dof_bones}, 0)

    def ancestors(self, bone: int) -> list[int]:
        """The bones from this one up to the root, itself first."""
        return ancestors(self.parents, bone)

    def inherited(self, own: Mapping[int, int], otherwise: int) -> np.ndarray:
        """(b,) int: for each bone the value that `own` has for it or for its nearest ancestor that has one, or
        `otherwise`."""
        found = np.full(self.bone_count, otherwise)
        for bone, parent in enumerate(self.parents):
            found[bone] = own.get(bone, found[parent] if bone else otherwise)
        return found

    def translation_change(self, elsewhere: np.ndarray) -> np.ndarray:
        """How the translations of `bone_transforms` change when joint centres move and rotations R (b, 3, 3) stay.

        Args:
            elsewhere: (b, 3) [m] by which heads move; zero for the root's.

        Returns:
            C (b, b, 3): the translation of bone i changes by the sum over bones k of R_k C[i, k].
        """
        change = np.zeros((self.bone_count, self.bone_count, 3))
        for bone in range(1, self.bone_count):
            parent = self.parents[bone]
            change[bone] = change[parent]
            change[bone, parent] += elsewhere[bone]
            change[bone, bone] -= elsewhere[bone]
        return change

    def to_json(self) -> dict[str, Any]:
        """Plain data (lists, strings, numbers) from which `from_json` makes an equal rig."""
        bones = [
            {"name": name, "parent": int(parent), "head": head.tolist(), "tail": tail.tolist()}
            for name, parent, head, tail in zip(self.bone_names, self.parents, self.heads, self.tails, strict=True)
        ]
        return {"bones": bones, "dofs": [vars(dof) | {"axis": list(dof.axis)} for dof in self.dofs]}

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Rig:
        """Inverse of `to_json`. Raises RigError on missing, unknown or malformed entries."""
        try:
            bones, dofs = data["bones"], data["dofs"]
            _reject_unknown("rig", data, ("bones", "dofs"))
            for bone in bones:
                _reject_unknown(f"bone {shown(bone['name'])}", bone, ("name", "parent", "head", "tail"))
            return cls(
                bone_names=tuple(str(bone["name"]) for bone in bones),
                parents=np.array([bone["parent"] for bone in bones]),
                heads=np.array([bone["head"] for bone in bones], dtype=np.float64),
                tails=np.array([bone["tail"] for bone in bones], dtype=np.float64),
                dofs=tuple(DegreeOfFreedom(**{**dof, "axis": tuple(dof["axis"])}) for dof in dofs),
            )
        except RigError:
            raise
        except (KeyError, TypeError, ValueError) as error:
            raise RigError(f"malformed rig description: {type(error).__name__}: {error}") from error


def ancestors(parents: Sequence[int] | np.ndarray, joint: int) -> list[int]:
    """From a joint itself up to the root. parents: of each joint, -1 for none."""
    way = []
    while joint >= 0:
        way.append(joint)
        joint = int(parents[joint])
    return way


def pose_vector(positions: np.ndarray, lower: np.ndarray, upper: np.ndarray, gravity: np.ndarray) -> np.ndarray:
    """Network input theta (..., p): joint positions (..., d) [rad] scaled to [-1, 1] by their limits and clipped, then
    gravity, a unit vector (..., 3) in the root frame."""
    theta = np.clip((np.asarray(positions) - (lower + upper) / 2) / ((upper - lower) / 2), -1.0, 1.0)
    return np.concatenate([theta, np.broadcast_to(gravity, (*theta.shape[:-1], 3))], axis=-1)


def forward_kinematics(
    parents: np.ndarray, heads: np.ndarray, dof_bones: np.ndarray, dof_axes: np.ndarray, angles: np.ndarray
) -> np.ndarray:
    """Canonical-to-posed transforms (..., b, 3, 4) of bones (parents (b,), heads (b, 3)) turned by angles (..., d)."""
    rotation = np.broadcast_to(np.eye(3), (*angles.shape[:-1], len(parents), 3, 3)).copy()
    for k, bone in enumerate(dof_bones):
        rotation[..., bone, :, :] = rotation[..., bone, :, :] @ axis_rotation(dof_axes[k], angles[..., k])
    position = np.broadcast_to(heads, (*angles.shape[:-1], *heads.shape)).copy()
    for bone in range(1, len(parents)):
        parent = parents[bone]
        offset = rotation[..., parent, :, :] @ (heads[bone] - heads[parent])
        position[..., bone, :] = position[..., parent, :] + offset
        rotation[..., bone, :, :] = rotation[..., parent, :, :] @ rotation[..., bone, :, :]
    translation = position - np.einsum("...bij,bj->...bi", rotation, heads)
    return np.concatenate([rotation, translation[..., None]], axis=-1)


def axis_rotation(axis: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Rodrigues' formula: rotation by `angle` (...,) [rad] about unit `axis` (3,). Returns (..., 3, 3)."""
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    angle = np.asarray(angle)[..., None, None]
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * (cross @ cross)


def _reject_duplicates(kind: str, names: Sequence[str]) -> None:
    twice = next((name for name, count in Counter(names).items() if count > 1), None)
    if twice is not None:
        raise RigError(f"{kind} {shown(twice)} occurs twice")


def _reject_unknown(where: str, entries: Mapping[str, Any], allowed: Sequence[str]) -> None:
    if unknown := sorted(str(key) for key in set(entries) - set(allowed)):
        raise RigError(f"{where} has unknown entries {listed(unknown)}; allowed: {', '.join(allowed)}")


def _check_dof(dof: DegreeOfFreedom, bone_index: Mapping[str, int]) -> None:
    if dof.bone not in bone_index:
        raise RigError(f"degree of freedom {shown(dof.name)} turns unknown bone {shown(dof.bone)}")
    numbers = np.array([*dof.axis, dof.lower, dof.upper, dof.rest], dtype=np.float64)
    if numbers.shape != (6,) or not np.isfinite(numbers).all():
        raise RigError(f"degree of freedom {shown(dof.name)}: axis, lower, upper and rest must be finite numbers")
    if np.linalg.norm(numbers[:3]) < 1e-9:
        raise RigError(f"degree of freedom {shown(dof.name)} has a zero axis")
    if not dof.lower < dof.upper:
        raise RigError(f"degree of freedom {shown(dof.name)}: lower {dof.lower} must be below upper {dof.upper}")
