"""LimbSeparator: joint positions in, out come those at which this body's arms and legs leave its trunk and each other.

Motion of a lean performer puts a stouter body's forearms into its belly. Dimensions: `d` degrees of freedom. Radians.
"""

from __future__ import annotations

import logging
import warnings
from dataclasses import astuple, dataclass, replace
from time import perf_counter
from weakref import WeakKeyDictionary

import numpy as np

from physkin_core.avatar.avatar import Avatar, AvatarWarning
from physkin_core.motion.motion import Motion
from physkin_core.native_module import native
from physkin_core.rig.rig import Rig
from physkin_core.separation.collision_shape import CollisionShape, fit_collision_shape

__all__ = ["BoundLimbs", "LimbSeparator", "SeparationSettings", "bind_limbs", "fit_limbs", "separated_motion"]

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class SeparationSettings:
    """How gently limbs are separated.

    onset: [m] outside the skin where a contact begins to count. softness: [m] over which it comes to count in full.
    pull: [m2/rad2] of a joint towards its given position. damping: [m2/rad2] towards its position in the last step.
    blend: [m] of height over which a trunk bone takes over from the one below. steps: how many.
    """

    onset: float = 0.01
    softness: float = 0.03
    pull: float = 0.01
    damping: float = 0.01
    blend: float = 0.06
    steps: int = 3


@dataclass(frozen=True)
class BoundLimbs:
    """The limbs of one body: what a `LimbSeparator` needs. shape: of the body. joint_names: (d,) of the rig. warnings:
    limbs that are left out, and why."""

    shape: CollisionShape
    joint_names: tuple[str, ...]
    warnings: tuple[str, ...] = ()


def fit_limbs(rig: Rig, avatar: Avatar) -> BoundLimbs:
    """Fit a collision shape to a body's skin: a tenth of a second. Arguments and ValueErrors: as of `LimbSeparator`."""
    if len(avatar.bone_heads) != rig.bone_count:
        raise ValueError(f"avatar {avatar.source} has {len(avatar.bone_heads)} bones, the rig {rig.bone_count}")
    started = perf_counter()
    shape, left_out = fit_collision_shape(avatar, rig, onset=SeparationSettings().onset)
    log.info("fitted a collision shape to %s in %.0f ms", avatar.source, 1e3 * (perf_counter() - started))
    return BoundLimbs(shape, rig.joint_names, left_out)


class LimbSeparator:
    """Moves arms and legs of one body out of its trunk and each other, a pose at a time. Not for two threads at once.

    A pose without contact comes back unchanged. Parts that touch in the canonical pose may touch. Positions stay within
    the rig's limits; a position beyond them goes no farther. The result depends on the pose alone, and
    continuously: smooth motion stays smooth.

    Args:
        rig: the rig of the joint positions.
        avatar: a body that is bound to it.

    Attributes:
        warnings: limbs that are left out, and why.

    Raises:
        ValueError: for a body of another rig, and a rig or body in which no arm or leg is found.

    Examples:
        >>> rig = physkin.load_garment_model("tshirt").rig
        >>> separator = physkin.LimbSeparator(rig, physkin.load_avatar("me.glb", rig))
        >>> positions, largest_change = separator.separate(rig.rest)
    """

    def __init__(self, rig: Rig, avatar: Avatar) -> None:
        self._bind(fit_limbs(rig, avatar))

    @classmethod
    def from_bound(cls, limbs: BoundLimbs) -> LimbSeparator:
        """A separator whose limbs have been fitted already, perhaps by another process."""
        separator = cls.__new__(cls)
        separator._bind(limbs)
        return separator

    def _bind(self, limbs: BoundLimbs) -> None:
        self.shape, self.joint_names, self.warnings = limbs.shape, limbs.joint_names, limbs.warnings
        self._separator = native.LimbSeparator(self.shape, *astuple(SeparationSettings()))

    def separate(self, joint_positions: np.ndarray, *, out: np.ndarray | None = None) -> tuple[np.ndarray, float]:
        """Move a pose by as little as needed.

        Args:
            joint_positions: (d,) [rad], in the order of `joint_names`.
            out: (d,) float32, C-contiguous; may be `joint_positions` itself. None: a new array.

        Returns:
            `out`, and the largest change of a position [rad], 0 if nothing was changed.

        Raises:
            ValueError: for another shape, and values that are not finite or beyond a million; `out` is then unchanged.
            TypeError: for an `out` of another kind.
        """
        positions = np.ascontiguousarray(joint_positions, dtype=np.float32)
        if positions.shape != (len(self.joint_names),):
            raise ValueError(f"joint positions have shape {positions.shape}, expected ({len(self.joint_names)},)")
        if out is None:
            out = np.empty_like(positions)
        return out, self._separator.separate(positions, out)


def bind_limbs(rig: Rig, avatar: Avatar) -> LimbSeparator:
    """The separator of a body bound to the rig. Its warnings are issued as AvatarWarning. Raises as it does."""
    separator = LimbSeparator(rig, avatar)
    for warning in separator.warnings:
        warnings.warn(f"{avatar.source}: {warning}", AvatarWarning, stacklevel=2)
    return separator


FITTED: WeakKeyDictionary[Avatar, LimbSeparator] = WeakKeyDictionary()
"""Of bodies whose motions are separated one after the other: to fit limbs takes as long as to drape 150 frames."""


def separated_motion(motion: Motion, rig: Rig, avatar: Avatar) -> Motion:
    """A motion whose limbs are separated, frame by frame, for a body bound to the rig. Warns and raises as
    `bind_limbs`."""
    separator = FITTED.get(avatar) or FITTED.setdefault(avatar, bind_limbs(rig, avatar))
    positions = [separator.separate(each)[0] for each in motion.positions_for(rig)]
    return replace(motion, joint_names=rig.joint_names, positions=np.array(positions))
