"""Landmarks of a person, as pose trackers give them, to joint positions of the default rig, frame by frame.

Directions between landmarks give the rotations of bones in closed form; limbs keep the rig's lengths, so that noise in
depth shrinks none. Landmarks are smoothed by the One Euro filter (Casiez et al., CHI 2012).

Dimensions: `K` landmarks of the tracker, `d` joints. X forward, Y left, Z up.
"""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from physkin_core.avatar.body_model import load_body_model
from physkin_core.file_reading import listed, shown
from physkin_core.motion.motion import MotionError
from physkin_core.rig.ball_joints import BallRotations
from physkin_core.rig.canonical_pose import smallest_rotation
from physkin_core.rig.joint_names import plain_name
from physkin_core.rig.rig import Rig, axis_rotation
from physkin_core.rig.vrm_bones import rig_ball_joint

__all__ = ["LANDMARK_SETS", "LandmarkReader"]

LANDMARK_SETS: dict[str, dict[str, str]] = json.loads(Path(__file__).with_name("landmark_sets.json").read_text())
"""Trackers' landmarks in their order; which of their axes point forward, left and up of who looks at the camera."""
PARTS = "eye ear shoulder elbow wrist hip knee ankle heel toe".split()
USED = {name: k for k, name in enumerate(["nose.", *(f"{part}.{side}" for part in PARTS for side in "LR")])}
PAIRS = {part: [USED[f"{part}.L"], USED[f"{part}.R"]] for part in PARTS}
SYNONYMS = {"footindex": "toe", "bigtoe": "toe", "foot": "toe"}
X, Y, Z = np.eye(3)

# Where landmarks are on the rig's body [m].
UP = np.array([0.021, 0.0, 0.466])  # from the middle of the hips to that of the shoulders
OTHER = {"hip": np.array([[0, 0.113, 0], [0, -0.113, 0]]) - UP, "shoulder": np.array([[0, 0.186, 0], [0, -0.186, 0]]) + UP}
NOSE, FACE = np.array([0.12, 0.0, -0.016]), np.array([0.1, 0.0, 0.011])  # from between the ears; FACE: nose and eyes
SOLE = {"ankle": 0.076, "heel": 0.03, "toe": 0.01}  # above the floor
TOE = {"ankle": np.array([0.2, -0.025, -0.066]), "heel": np.array([0.256, -0.02, -0.02])}  # from there, on the left

SPINE, NECK = ("spine05", "spine03", "spine02"), ("neck01", "neck03", "head")  # each turns by a third
FARTHEST = 1e7  # in the tracker's unit
PLAUSIBLE = 0.4, 2.0  # length of a limb's half, as a share of the rig's at this size
SIZES = 100  # frames over whose median the size is taken
SLOWEST_HZ, HZ_A_SPEED, SPEED_HZ = 1.0, 1.5, 1.0
"""The filter's cutoff at rest, its rise [Hz / (m/s)], and the cutoff of the speed."""
CARRY, RECENT, HELD, EASE, TRUST, SINK = 0.1, 0.25, 1.0, 1.5, 0.3, 2.0
"""[s] that a lost landmark moves on, and counts; that a lost limb is held, in which it goes most of the way to rest, in
which it takes up again; in which the floor rises to a foot."""
STRAIGHT, NATURAL = 0.1, 0.03
"""Sines of the bend up to which a limb bends about the axis of before, and about the one that needs no twist."""


class LandmarkReader:
    """Reads landmarks of one person, frame by frame, as joint positions of the default rig and its root.

    What is lost is held for a second, then eased to rest, where collarbones, hands and the twist of forearms always
    are. Lost hips are taken to hang below the shoulders, as they last did.

    Args:
        names: of the landmarks, in their order: a tracker (`mediapipe`, `coco`, `body_25`, `kinect_v2`,
            `azure_kinect`), or a list. `left_foot_index`, `LBigToe` and `FootLeft` are one. Used are the nose, and left
            and right eye, ear, shoulder, elbow, wrist, hip, knee, ankle, heel and toe.
        axes: which of the tracker's axes point forward, left and up of a person who looks at the camera; a camera's
            are "-z x -y". None: the tracker's own, "x y z" for a list. Any unit will do.
        renamed: names in `names` -> names that are understood.
        least_confidence: below it a landmark is lost, as it is where it is not finite, or exactly 0, 0, 0.

    Attributes:
        status: "seen"; "part", where limbs, hips or the head are not; "lost", where the trunk is not.
        lost: what is not seen, such as ("left arm", "head").

    Raises:
        MotionError: for an unknown tracker, axes that are not three different ones, or names without shoulders or hips.

    Examples:
        >>> reader = physkin.LandmarkReader("coco")
        >>> positions, root = reader.read(np.full((17, 3), np.nan), time_s=0.0)
        >>> positions.shape, root.shape, reader.status
        ((52,), (7,), 'lost')
    """

    def __init__(
        self,
        names: str | Sequence[str] = "mediapipe",
        *,
        axes: str | None = None,
        renamed: Mapping[str, str] | None = None,
        least_confidence: float = 0.3,
    ) -> None:
        default_axes = "x y z"
        if isinstance(names, str):
            if names not in LANDMARK_SETS:
                raise MotionError(f"no tracker {shown(names)}; there are {', '.join(LANDMARK_SETS)}; or give a list")
            default_axes, names = LANDMARK_SETS[names]["axes"], LANDMARK_SETS[names]["names"].split()
        self._axes = _axes(axes or default_axes)
        self._count, self._least = len(names), least_confidence
        columns: dict[int, int] = {}
        for column, name in enumerate(names):
            part, _, side = plain_name((renamed or {}).get(name, name)).partition(".")
            if (row := USED.get(f"{SYNONYMS.get(part, part)}.{side}")) is not None:
                columns.setdefault(row, column)
        if missing := [f"{part}.{side}" for part in OTHER for side in "LR" if USED[f"{part}.{side}"] not in columns]:
            raise MotionError(f"no landmark for {', '.join(missing)} among {listed(names)}; rename yours")
        self._rows, self._columns = list(columns), list(columns.values())
        self._rig = load_body_model().rig
        self._limbs = [_Limb(self._rig, side, parts) for side in "LR" for parts in (ARM, LEG)]
        joints = {bone: ([f"{bone}_{axis}" for axis in "xyz"], "") for bone in (*SPINE, *NECK)}
        for limb in self._limbs:
            joints |= limb.joints
        self._row = {bone: row for row, bone in enumerate(joints)}
        balls = [rig_ball_joint(self._rig, names, half=half) for names, half in joints.values()]
        self._solver = BallRotations(balls, self._rig.joint_indices)
        self.reset()

    def reset(self) -> None:
        """Start anew, with another person."""
        count = len(USED) + 1
        self._value, self._speed, self._at = np.zeros((count, 3)), np.zeros((count, 3)), np.full((count, 1), -np.inf)
        self._time, self._sizes = -np.inf, deque[float](maxlen=SIZES)
        self._other = dict(OTHER)
        self._hinges: dict[str, np.ndarray] = {}
        self._seen_at, self._trust = np.full(len(self._row) + 1, -np.inf), np.zeros(len(self._row) + 1)  # root's is last
        self._floor: float | None = None
        self._positions, self._root, self._place = self._rig.rest.copy(), np.eye(3), 0.914 * Z
        self.status, self.lost = "lost", ("trunk",)

    def read(
        self, points: np.ndarray, confidence: np.ndarray | None = None, *, time_s: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """The pose at a time.

        Args:
            points: (K, 3) in the tracker's axes.
            confidence: (K,) 0 to 1. None: all are trusted.
            time_s: [s]; where it goes back, the reader starts anew.

        Returns:
            Joint positions (d,) [rad] within the rig's limits, and the root (7,) as `Draper.drape` takes it. The lowest
            foot stands on Z = 0; where the tracker says where the person is, jumps are seen, too.

        Raises:
            MotionError: for another shape, or a time that is not finite.
        """
        points = np.asarray(points, dtype=np.float64)
        trusted = np.ones(self._count) if confidence is None else np.asarray(confidence, dtype=np.float64)
        if points.shape != (self._count, 3) or trusted.shape != (self._count,) or not np.isfinite(time_s):
            depth = "; these lack depth: take world landmarks, or lift them" if points.shape[1:] == (2,) else ""
            raise MotionError(
                f"points {points.shape}, confidence {trusted.shape} at {time_s} s; expected ({self._count}, 3), "
                f"({self._count},) and a finite time{depth}"
            )
        if time_s < self._time:
            self.reset()
        passed, self._time = min(time_s - self._time, 10.0), time_s
        good = (np.abs(points) < FARTHEST).all(axis=1) & points.any(axis=1) & (trusted >= self._least)
        found, seen = np.zeros((len(USED), 3)), np.zeros(len(USED), dtype=bool)
        found[self._rows] = np.where(good[:, None], points, 0.0)[self._columns] @ self._axes.T
        seen[self._rows] = good[self._columns]
        turns: dict[str, np.ndarray] = {}
        self.status, self.lost = "lost", ("trunk",)
        if self._measured(found, seen) and (pair := self._with_trunk(found, seen, passed)):
            seen = self._smooth(found, seen, passed)
            turns, lost = self._turns(seen)
            self.lost = (*(["hips"] if pair == "shoulder" else []), *lost)
            self.status = "part" if self.lost else "seen"
            self._stand(seen, passed)
        self._follow(turns, passed)
        return self._positions.copy(), np.array([*self._place, *Rotation.from_matrix(self._root).as_quat()])

    def _measured(self, found: np.ndarray, seen: np.ndarray) -> bool:
        """Take the person's size; ends of limbs that it makes implausible are not seen. Whether the size is known."""
        halves = [half for limb in self._limbs for half in limb.halves if seen[half[0]] and seen[half[1]]]
        if not self._sizes and not halves:
            halves = [(a, b, UP[2]) for a, b in zip(PAIRS["hip"], PAIRS["shoulder"]) if seen[a] and seen[b]]
        sizes = [float(np.linalg.norm(found[b] - found[a])) / length for a, b, length in halves]
        if sizes and np.median(sizes) > 0:
            self._sizes.append(float(np.median(sizes)))
        if not self._sizes:
            return False
        self._size = float(np.median(self._sizes))
        for (_, end, _), size in zip(halves, sizes):
            seen[end] &= PLAUSIBLE[0] < size / self._size < PLAUSIBLE[1]
        return True

    def _with_trunk(self, found: np.ndarray, seen: np.ndarray, passed: float) -> str:
        """Put a lost pair, hips or shoulders, where it was beside the other. The pair that is seen; "hip" for both."""
        for here, there in (("hip", "shoulder"), ("shoulder", "hip")):
            if not seen[PAIRS[here]].all():
                continue
            left, right = found[PAIRS[here]]
            x, y, _ = left - right
            level = _turn(np.array([x, y, 0]), Z, Y, Z)
            middle = (left + right) / 2
            if here == "hip" and seen[PAIRS[there]].all():
                self._other["shoulder"] = (found[PAIRS["shoulder"]] - middle) @ level / self._size
                shoulders = found[PAIRS["shoulder"]]
                x, y, _ = shoulders[0] - shoulders[1]
                level = _turn(np.array([x, y, 0]), Z, Y, Z)
                self._other["hip"] = (found[PAIRS["hip"]] - shoulders.mean(axis=0)) @ level / self._size
            else:
                self._other[there] = self._other[there] + (OTHER[there] - self._other[there]) * (1 - np.exp(-passed / EASE))
                found[PAIRS[there]] = middle + self._size * self._other[there] @ level.T
                seen[PAIRS[there]] = True
            return here
        return ""

    def _smooth(self, found: np.ndarray, seen: np.ndarray, passed: float) -> np.ndarray:
        """Smooth landmarks in the rig's size, from the middle of the hips, and that itself. Which of them count."""
        hips = found[PAIRS["hip"]].mean(axis=0)
        now = np.array([*seen, True])
        here, value, speed = np.array([*(found - hips), hips])[now] / self._size, self._value[now], self._speed[now]
        since = np.maximum(self._time - self._at[now], 1e-6)
        speed = speed + _share(SPEED_HZ, since) * ((here - value) / since - speed)
        cutoff = SLOWEST_HZ + HZ_A_SPEED * np.linalg.norm(speed, axis=1, keepdims=True)
        self._speed[~now] *= np.exp(-passed / CARRY)
        self._value[~now] += self._speed[~now] * passed
        self._value[now] = value + _share(cutoff, since) * (here - value)
        self._speed[now], self._at[now] = speed, self._time
        return self._time - self._at[:-1, 0] < RECENT

    def _turns(self, seen: np.ndarray) -> tuple[dict[str, np.ndarray], list[str]]:
        """Rotations (3, 3) of the rig's bones from their parents, of "root" from the world; which parts are lost."""
        at = self._value
        middle = {part: at[pair].mean(axis=0) for part, pair in PAIRS.items()}
        left = {part: at[a] - at[b] for part, (a, b) in PAIRS.items()}
        up = middle["shoulder"] - middle["hip"]
        root, chest = (_turn(left[part], up, Y, UP) for part in ("hip", "shoulder"))
        turns, lost = {"root": root} | dict.fromkeys(SPINE, _third(root.T @ chest)), []
        nose = USED["nose."]
        if seen[[nose, *PAIRS["ear"]]].all():
            eyes = seen[PAIRS["eye"]].all()
            face = at[[nose, *PAIRS["eye"]]].mean(axis=0) if eyes else at[nose]
            head = _turn(left["ear"], face - middle["ear"], Y, FACE if eyes else NOSE)
            turns |= dict.fromkeys(NECK, _third(chest.T @ head))
        elif nose in self._rows:
            lost.append("head")
        for limb in self._limbs:
            carrier = chest if limb.parts is ARM else root
            if not seen[limb.rows[:3]].all():
                lost.append(limb.name)
            turns |= limb.turns(at, seen, carrier, self._hinges)
        return turns, lost

    def _stand(self, seen: np.ndarray, passed: float) -> None:
        """Place the root: the lowest foot is on the floor, or the floor where the lowest foot was of late."""
        hips = self._value[-1]
        placed = np.linalg.norm(hips) > 0.1
        feet = [self._value[row, 2] - height for part, height in SOLE.items() for row in PAIRS[part] if seen[row]]
        lowest = hips[2] + min(feet, default=-self._place[2])
        rise = lowest - (lowest if self._floor is None else self._floor)
        self._floor = lowest - rise * np.exp(-passed / SINK) if placed and rise > 0 else lowest
        self._place = np.array([*(hips[:2] * placed), hips[2] - self._floor])

    def _follow(self, turns: dict[str, np.ndarray], passed: float) -> None:
        """Joints and root follow their rotations; the others are held, then eased to rest."""
        now = np.array([bone in turns for bone in (*self._row, "root")])
        self._trust = np.clip(self._trust + np.where(now, passed, -passed) / TRUST, 0, 1)
        if not np.isfinite(self._seen_at).any():
            self._trust[now] = 1.0
        self._seen_at[now] = self._time
        ease = np.where(self._time - self._seen_at <= HELD, 0.0, 1 - np.exp(-passed / EASE))
        target = turns.pop("root", smallest_rotation(self._root @ Z, Z) @ self._root)
        share = self._trust[-1] if now[-1] else ease[-1]
        self._root = self._root @ _part(self._root.T @ target, share)
        every = np.tile(np.eye(3), (len(self._row), 1, 1))
        if turns:
            every[[self._row[bone] for bone in turns]] = np.stack(list(turns.values()))
        solved = np.zeros(len(self._positions))
        self._solver.solve(every, solved)
        dofs, owner = self._solver.targets, self._solver.owners
        wanted = self._rig.rest[dofs] + np.where(now[owner], solved[dofs], 0)
        wanted = np.clip(wanted, self._rig.lower[dofs], self._rig.upper[dofs])
        self._positions[dofs] += np.where(now, self._trust, ease)[owner] * (wanted - self._positions[dofs])


ARM = ("shoulder", "elbow", "wrist"), ("upperarm01", "lowerarm01", "wrist"), ("xyz", "upperarm02", "y", "z")
LEG = ("hip", "knee", "ankle"), ("upperleg01", "lowerleg01", "foot"), ("yxz", "upperleg02", "z", "y")


class _Limb:
    """An arm or a leg: its landmarks' rows and, at rest, where its halves point and the axis that it bends about."""

    def __init__(self, rig: Rig, side: str, parts) -> None:
        landmarks, bones, (ball, second, twist, hinge) = self.parts = parts
        self.name = f"{'left' if side == 'L' else 'right'} {'arm' if parts is ARM else 'leg'}"
        self.bones = [f"{bone}.{side}" for bone in bones]
        rows = [f"{part}.{side}" for part in (*landmarks, *(("heel", "toe") if parts is LEG else ()))]
        self.rows = [USED[row] for row in rows]
        a, b, c = (rig.heads[rig.bone_index(bone)] for bone in self.bones)
        self.upper, self.lower = _unit(b - a), _unit(c - b)
        self.halves = [(self.rows[0], self.rows[1], np.linalg.norm(b - a)), (self.rows[1], self.rows[2], np.linalg.norm(c - b))]
        joint = rig.joint_indices[f"{self.bones[1]}_{hinge}"]
        self.axis = rig.dof_axes[joint] * np.sign(rig.lower[joint] + rig.upper[joint])
        upper, elbow, foot = self.bones
        self.joints = {upper: ([f"{upper}_{axis}" for axis in ball], f"{second}.{side}_{twist}"), elbow: ([f"{elbow}_{hinge}"], "")}
        if parts is LEG:
            self.joints[foot] = ([f"{foot}_{axis}" for axis in "yz"], "")
        self.mirror = np.array([1, 1 if side == "L" else -1, 1])
        # upper . (lower turned about the axis by an angle) = constant + reach * cos(angle - straight)
        self.constant = (self.axis @ self.lower) * (self.axis @ self.upper)
        sine, cosine = self.upper @ np.cross(self.axis, self.lower), self.upper @ self.lower - self.constant
        self.straight, self.reach = np.arctan2(sine, cosine), np.hypot(sine, cosine)

    def turns(self, at: np.ndarray, seen: np.ndarray, carrier: np.ndarray, hinges: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        a, b, c, *foot = self.rows
        upper, lower = at[b] - at[a], at[c] - at[b]
        if not (seen[a] and seen[b] and np.linalg.norm(upper) > 0.01):
            return {}
        bent = seen[c] and np.linalg.norm(lower) > 0.01
        upper, lower = _unit(upper), _unit(lower)
        usual = smallest_rotation(self.upper, carrier.T @ upper) @ self.axis
        axis = carrier @ (STRAIGHT * hinges.get(self.name, usual) + NATURAL * usual)
        axis_rest = (STRAIGHT + NATURAL) * self.axis
        if bent:
            angle = self.straight + np.arccos(np.clip((upper @ lower - self.constant) / self.reach, -1, 1))
            bend = axis_rotation(self.axis, angle)
            axis = axis + np.cross(upper, lower)
            axis_rest = axis_rest + np.cross(self.upper, bend @ self.lower)
        above = _turn(upper, axis, self.upper, axis_rest)
        hinges[self.name] = carrier.T @ above @ self.axis
        turns = {self.bones[0]: carrier.T @ above}
        if bent:
            turns[self.bones[1]] = bend
            below = above @ bend
            if foot and seen[foot[1]]:
                start = "heel" if seen[foot[0]] else "ankle"
                sole = at[foot[1]] - at[foot[0] if seen[foot[0]] else c]
                turns[self.bones[2]] = below.T @ _turn(sole, below @ Y, TOE[start] * self.mirror, Y)
        return turns


def _axes(text: str) -> np.ndarray:
    """(3, 3) ours <- the tracker's. Raises MotionError."""
    words = text.split()
    if sorted(word[-1:] for word in words) != ["x", "y", "z"] or any(word[:-1] not in ("", "-", "+") for word in words):
        raise MotionError(f'axes are {shown(text)}; expected those that point forward, left and up, such as "-z x -y"')
    return np.stack([(-1.0 if word[0] == "-" else 1.0) * np.eye(3)["xyz".index(word[-1])] for word in words])


def _share(cutoff_hz: float | np.ndarray, passed: np.ndarray) -> np.ndarray:
    """Of a change that a first-order filter lets through after a time."""
    return 1 / (1 + 1 / (2 * np.pi * cutoff_hz * passed))


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / max(float(np.linalg.norm(vector)), 1e-9)


def _frame(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """(3, 3) columns: the first direction, the second at right angles to it, and their cross product."""
    first = _unit(first)
    third = _unit(np.cross(first, second))
    return np.stack([first, np.cross(third, first), third], axis=1)


def _turn(first: np.ndarray, second: np.ndarray, first_rest: np.ndarray, second_rest: np.ndarray) -> np.ndarray:
    """The rotation (3, 3) that takes the directions at rest to those that are seen, the first exactly."""
    return _frame(first, second) @ _frame(first_rest, second_rest).T


def _part(turn: np.ndarray, share: float) -> np.ndarray:
    """A share of a rotation (3, 3)."""
    return Rotation.from_rotvec(share * Rotation.from_matrix(turn).as_rotvec()).as_matrix()


def _third(turn: np.ndarray) -> np.ndarray:
    return _part(turn, 1 / 3)
