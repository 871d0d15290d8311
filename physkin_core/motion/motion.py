"""Motion clips: joint positions and root placement at a fixed rate.

Dimensions: `T` frames, `d` degrees of freedom. Radians, metres, seconds; world and root frame have Z up.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from physkin_core.rig.rig import Rig

__all__ = ["MOST_FRAMES", "Motion", "MotionError", "upright_orientation"]

CLOSED_POSITION = 0.02  # [rad] a clip whose ends differ by less repeats as a cycle
CLOSED_GRAVITY = 0.02
MOST_FRAMES = 500_000
"""Of a clip that is resampled or put together: more than two hours at 60 Hz."""
RATES_HZ = (0.001, 100_000.0)


class MotionError(ValueError):
    """A motion clip is unknown, unreadable or inconsistent."""


@dataclass(frozen=True)
class Motion:
    """A motion of T frames.

    Attributes:
        joint_names: (d,) names of the columns of `positions`, as in `sensor_msgs/JointState`.
        positions: (T, d) float32 [rad].
        root_orientation: (T, 4) float32 unit quaternions x, y, z, w from root to world.
        root_position: (T, 3) float32 [m], the root in the world, whose floor is Z = 0.
        rate_hz: frames a second.
        name: of the clip.

    Examples:
        >>> walk = physkin.load_motion("walk").looped(10.0).resampled(30.0)
        >>> walk.frame_count
        301
    """

    joint_names: tuple[str, ...]
    positions: np.ndarray
    root_orientation: np.ndarray
    root_position: np.ndarray
    rate_hz: float
    name: str = ""

    def __post_init__(self) -> None:
        """Check and convert. Raises MotionError naming the field, its value and what was expected."""
        names = tuple(self.joint_names)
        if len(set(names)) != len(names):
            raise MotionError(f"motion {self.name!r}: joint names must be unique, got {', '.join(names)}")
        positions = np.asarray(self.positions, dtype=np.float32)
        if positions.ndim != 2 or len(positions) == 0 or positions.shape[1] != len(names):
            raise MotionError(
                f"motion {self.name!r}: positions have shape {positions.shape}; expected (T, {len(names)}), T > 0"
            )
        arrays = {"positions": positions}
        for field, width in (("root_orientation", 4), ("root_position", 3)):
            arrays[field] = np.asarray(getattr(self, field), dtype=np.float32)
            if arrays[field].shape != (len(positions), width):
                raise MotionError(
                    f"motion {self.name!r}: {field} has shape {arrays[field].shape}; "
                    f"expected ({len(positions)}, {width})"
                )
        for field, array in arrays.items():
            if not np.isfinite(array).all():
                raise MotionError(f"motion {self.name!r}: {field} holds values that are not finite")
        lengths = np.linalg.norm(arrays["root_orientation"], axis=1, keepdims=True)
        if np.abs(lengths - 1).max() > 0.01:
            raise MotionError(f"motion {self.name!r}: root_orientation must be unit quaternions, got length {lengths}")
        arrays["root_orientation"] = arrays["root_orientation"] / lengths
        if not RATES_HZ[0] <= self.rate_hz <= RATES_HZ[1]:
            raise MotionError(
                f"motion {self.name!r}: rate_hz must be from {RATES_HZ[0]} to {RATES_HZ[1]:.0f}, got {self.rate_hz}"
            )
        object.__setattr__(self, "joint_names", names)
        for field, array in arrays.items():
            object.__setattr__(self, field, array)

    @property
    def frame_count(self) -> int:
        """Number of frames T."""
        return len(self.positions)

    @property
    def gravity(self) -> np.ndarray:
        """(T, 3) float32 unit direction of gravity (world -Z) in the root frame."""
        x, y, z, w = self.root_orientation.T
        down = [2 * (w * y - x * z), -2 * (w * x + y * z), 2 * (x * x + y * y) - 1]
        return np.stack(down, axis=1)

    @property
    def times(self) -> np.ndarray:
        """(T,) [s] of the frames, from 0 on."""
        return np.arange(self.frame_count) / self.rate_hz

    @property
    def root(self) -> np.ndarray:
        """(T, 7) where the root is: x, y, z [m] and its quaternion x, y, z, w, as `Draper.drape` takes it."""
        return np.concatenate([self.root_position, self.root_orientation], axis=1)

    @property
    def is_cycle(self) -> bool:
        """Whether the last pose is the first one again, wherever the body has walked meanwhile."""
        if self.frame_count == 1:
            return False
        gap = np.abs(self.positions[-1] - self.positions[0]).max(initial=0.0)
        tilt = np.linalg.norm(self.gravity[-1] - self.gravity[0])
        return bool(gap < CLOSED_POSITION and tilt < CLOSED_GRAVITY)

    def positions_for(self, rig: Rig) -> np.ndarray:
        """Joint positions for another rig, matched by name.

        Args:
            rig: the other rig. Its joints that the motion does not have stay at rest; joints that only the motion has
                are ignored.

        Returns:
            (T, d) float32 [rad] in the order of that rig.

        Raises:
            MotionError: if no name matches.

        Examples:
            >>> rig = physkin.load_garment_model("tshirt").rig
            >>> physkin.load_motion("walk").positions_for(rig).shape
            (77, 52)
        """
        column = {name: k for k, name in enumerate(self.joint_names)}
        names = rig.joint_names
        matched = [k for k, name in enumerate(names) if name in column]
        if not matched:
            raise MotionError(
                f"motion {self.name!r} has no joint of the rig: it moves {', '.join(self.joint_names[:3])}, ..., "
                f"the rig has {', '.join(rig.joint_names[:3])}, ..."
            )
        positions = np.tile(rig.rest.astype(np.float32), (self.frame_count, 1))
        positions[:, matched] = self.positions[:, [column[names[k]] for k in matched]]
        return positions

    def resampled(self, rate_hz: float) -> Motion:
        """The motion at another rate, by cubic splines, so that velocities do not jump at the old frames.

        Args:
            rate_hz: frames a second.

        Returns:
            A motion with the same first and last frame: time is stretched by less than half a new frame.

        Raises:
            MotionError: for a rate that is not positive and finite, or gives more than `MOST_FRAMES`.
        """
        from scipy.interpolate import CubicSpline
        from scipy.spatial.transform import Rotation, RotationSpline

        if not (math.isfinite(rate_hz) and rate_hz > 0):
            raise MotionError(f"rate_hz must be positive and finite, got {rate_hz}")
        if self.frame_count == 1:
            return replace(self, rate_hz=float(rate_hz))
        if (frames := self.frame_count * rate_hz / self.rate_hz) > MOST_FRAMES:
            raise MotionError(
                f"motion {self.name!r} has {frames:.3g} frames at {rate_hz:g} Hz, at most {MOST_FRAMES} are made; "
                "choose a lower rate, or cut it"
            )
        old_times = np.arange(self.frame_count)
        times = np.linspace(0, old_times[-1], 1 + max(1, round(old_times[-1] * rate_hz / self.rate_hz)))
        orientation = RotationSpline(old_times, Rotation.from_quat(self.root_orientation))
        return replace(
            self,
            positions=CubicSpline(old_times, self.positions, bc_type="natural")(times),
            root_orientation=orientation(times).as_quat(),
            root_position=CubicSpline(old_times, self.root_position, bc_type="natural")(times),
            rate_hz=float(rate_hz),
        )

    def looped(self, seconds: float) -> Motion:
        """The motion repeated or cut, without a jump.

        Args:
            seconds: length of the result. A cycle (`is_cycle`) repeats, each round starting where the last one ended
                and facing the same way; any other motion is played forwards and backwards in turn.

        Returns:
            Exactly ceil(seconds * rate_hz) frames.

        Raises:
            MotionError: for a length that is not positive and finite.
        """
        if not (math.isfinite(seconds) and seconds > 0):
            raise MotionError(f"seconds must be positive and finite, got {seconds}")
        frames = np.arange(math.ceil(round(seconds * self.rate_hz, 6)))
        rounds, index = np.divmod(frames, max(1, self.frame_count - 1))
        if not self.is_cycle:
            index = np.where(rounds % 2 == 0, index, self.frame_count - 1 - index)
            rounds = np.zeros_like(rounds)
        orientation, position = self._carried_on(index, rounds)
        return replace(self, positions=self.positions[index], root_orientation=orientation, root_position=position)

    def _carried_on(self, index: np.ndarray, rounds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Root orientation (F, 4), position (F, 3) of frames `index` (F,) after `rounds` (F,) rounds of the cycle."""
        from scipy.spatial.transform import Rotation

        orientation = Rotation.from_quat(self.root_orientation)
        round_turn = (orientation[-1] * orientation[0].inv()).as_rotvec()[2]
        heading = Rotation.from_rotvec(np.arange(rounds.max() + 2)[:, None] * [0.0, 0.0, round_turn])
        start, end = self.root_position[0] * [1, 1, 0], self.root_position[-1] * [1, 1, 0]
        shift = np.cumsum(heading[:-1].apply(end) - heading[1:].apply(start), axis=0)  # a round starts at the last end
        shift = np.concatenate([np.zeros((1, 3)), shift])
        turn = heading[rounds]
        return (turn * orientation[index]).as_quat(), turn.apply(self.root_position[index]) + shift[rounds]


def upright_orientation(gravity: np.ndarray) -> np.ndarray:
    """Unit quaternions (T, 4) x, y, z, w, world <- root: the smallest rotations that turn gravity (T, 3), of any length
    but zero, to -Z; about X where none is smallest."""
    x, y, z = (gravity / np.linalg.norm(gravity, axis=-1, keepdims=True)).T
    quaternion = np.stack([-y, x, np.zeros_like(x), 1 - z], axis=-1)
    length = np.linalg.norm(quaternion, axis=-1, keepdims=True)
    return np.where(length > 1e-6, quaternion / np.maximum(length, 1e-6), [1.0, 0.0, 0.0, 0.0])
