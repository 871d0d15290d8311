"""Landmarks of a person, as pose trackers give them, to joint positions of the default rig, frame by frame.

Directions between landmarks give the rotations of bones in closed form. Limbs keep the rig's lengths, so that noise in
depth shrinks none. Landmarks are smoothed by the One Euro filter (Casiez et al., CHI 2012).

Dimensions: `K` landmarks of the tracker, `d` joints. X forward, Y left, Z up.
"""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from physkin_core.avatar.body_model import load_body_model
from physkin_core.file_reading import listed, shown
from physkin_core.motion.motion import MotionError
from physkin_core.rig.ball_joints import BallRotations
from physkin_core.rig.canonical_pose import smallest_rotation
from physkin_core.rig.joint_names import plain_name
from physkin_core.rig.rig import Rig, axis_rotation
from physkin_core.rig.vrm_bones import ball_entry, rig_ball_joint

__all__ = ["LANDMARK_SETS", "LandmarkReader"]

LANDMARK_SETS: dict[str, dict[str, str]] = json.loads(Path(__file__).with_name("landmark_sets.json").read_text())
"""Trackers' landmarks in their order; which of their axes point forward, left and up of who looks at the camera; who
guesses depth, from one picture."""
PARTS = "eye ear shoulder hip elbow wrist knee ankle heel toe".split()
USED = ["nose.", *(f"{part}.{side}" for part in PARTS for side in "LR")]
SYNONYMS = {"footindex": "toe", "bigtoe": "toe", "foot": "toe"}
EARS, SHOULDERS, HIPS, TRUNK, FACE = slice(3, 5), slice(5, 7), slice(7, 9), slice(5, 9), slice(5)
FEET = [15, 16, 19, 20]  # ankles and toes
X, Y, Z = np.eye(3)
# On the rig's body [m]:
STANDING = np.array([[0.021, 0.186, 0.466], [0.021, -0.186, 0.466], [0, 0.113, 0], [0, -0.113, 0]])  # trunk
UP, AHEAD = np.array([0.021, 0.0, 0.466]), np.array([0.1, 0.0, 0.011])  # hips to shoulders; ears to eyes and nose
HEEL_TO_TOE, ANKLE_TO_TOE = np.array([0.256, 0.02, -0.02]), np.array([0.2, 0.025, -0.066])  # of the right foot
SOLE = {"ankle": 0.076, "heel": 0.03, "toe": 0.01}  # how high above the floor
SPINE, NECK = ("spine05", "spine03", "spine02"), ("neck01", "neck03", "head")  # each turns by a third

FARTHEST = 1e7  # in the tracker's unit
PLAUSIBLE = 0.4, 2.0  # length of a limb's half, as a share of the rig's at this size
SIZES = 100  # frames of which the person's size, the forearms' length and the camera's tilt are taken
CLEARLY = 0.2  # share of a forearm's length by which it is nearer or farther at its end, for the sign to be believed
STANDS = 1.1  # [m] at least, shoulders above the feet; who sits has 1.07, however the camera is tilted
SLOWEST_HZ, HZ_A_SPEED, SPEED_HZ = 0.7, 5.0, 1.0
"""The filter's cutoff at rest, its rise [Hz / (m/s)], and the cutoff of the speed."""
CARRY, RECENT, HELD, EASE, TRUST, SINK = 0.1, 0.25, 1.0, 1.5, 0.3, 2.0
"""[s] that a lost landmark moves on, and counts; that a lost limb is held, in which it goes most of the way to rest, in
which it takes up again; in which the floor rises to a foot."""
STRAIGHT, NATURAL = 0.3, 0.03
"""Sines of the bend up to which a limb bends about the axis of before, and about the one that needs no twist."""
NUMBERS = """plausible sizes clearly stands slowest_hz hz_a_speed speed_hz carry recent held ease trust straight natural
standing up ahead""".split()


class LandmarkReader:
    """Reads landmarks of one person, frame by frame, as joint positions of the default rig and its root.

    What is lost is held for a second and then eased to rest, where collarbones, hands and the twist of forearms always
    are. Hips that stay lost come to hang below the shoulders.

    Args:
        names: of the landmarks, in their order: a tracker (`mediapipe`, `coco`, `body_25`, `kinect_v2`,
            `azure_kinect`), or a list. `left_foot_index`, `LBigToe` and `FootLeft` are one. Used are the nose, and left
            and right eye, ear, shoulder, elbow, wrist, hip, knee, ankle, heel and toe.
        axes: which of the tracker's axes point forward, left and up of a person who looks at the camera; a camera's
            are "-z x -y". None: the tracker's own, "x y z" for a list. Any unit will do. MediaPipe's depth is then
            mended: its landmarks come to stand upright however the camera is tilted.
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
        tracker = {"axes": "x y z"}
        if isinstance(names, str):
            if names not in LANDMARK_SETS:
                raise MotionError(f"no tracker {shown(names)}; there are {', '.join(LANDMARK_SETS)}; or give a list")
            tracker = LANDMARK_SETS[names]
            names = tracker["names"].split()
        self._axes, self._count, self._least = _axes(axes or tracker["axes"]), len(names), least_confidence
        self._guessed = axes is None and "depth" in tracker
        columns: dict[str, int] = {}
        for column, name in enumerate(names):
            part, _, side = plain_name((renamed or {}).get(name, name)).partition(".")
            columns.setdefault(f"{SYNONYMS.get(part, part)}.{side}", column)
        if missing := [name for name in USED[TRUNK] if name not in columns]:
            raise MotionError(f"no landmark for {', '.join(missing)} among {listed(names)}; rename yours")
        self._columns = np.array([columns.get(name, len(names)) for name in USED])
        self._rig = load_body_model().rig
        self._limbs = [_Limb(self._rig, limb, side) for side in ("left", "right") for limb in LIMBS]
        joints = {bone: ([f"{bone}_{axis}" for axis in "xyz"], "") for bone in (*SPINE, *NECK)}
        for limb in self._limbs:
            joints |= limb.joints
        self._bones = (*joints, "root")
        self._balls = {bone: rig_ball_joint(self._rig, names, half=half) for bone, (names, half) in joints.items()}
        self._solver = BallRotations([*self._balls.values()], self._rig.joint_indices)
        self.reset()

    def reset(self) -> None:
        """Start anew, with another person."""
        count, bones = len(USED) + 1, len(self._bones)
        self._value, self._speed, self._at = np.zeros((count, 3)), np.zeros((count, 3)), np.full((count, 1), -np.inf)
        self._value[TRUNK], self._time, self._sizes = STANDING, -np.inf, deque[float](maxlen=SIZES)
        self._forearms, self._leans = deque[float](maxlen=SIZES), deque[float](maxlen=SIZES)
        self._seen_at, self._trust, self._hinges = np.full(bones, -np.inf), np.zeros(bones), dict[str, np.ndarray]()
        self._positions, self._root = self._rig.rest.copy(), np.eye(3)
        self._place, self._floor = np.array([0.0, 0.0, 0.914]), np.nan
        self.status = "lost"
        self.lost: tuple[str, ...] = ("trunk",)

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
        from scipy.spatial.transform import Rotation

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
        seen = np.append(good, False)[self._columns]
        found = np.append(np.where(good[:, None], points, 0.0), np.zeros((1, 3)), axis=0)[self._columns] @ self._axes.T
        turns: dict[str, np.ndarray] = {}
        self.status, self.lost = "lost", ("trunk",)
        if self._measured(found, seen) and seen[TRUNK].sum() > 1:
            found /= self._size
            counts = self._smooth(self._in_space(found, seen) if self._guessed else found, seen, passed)
            turns, lost = self._turns(counts, STRAIGHT * float(np.exp(-passed / RECENT)))
            self.lost = (*lost, *(["hips"] if not seen[HIPS].all() else []))
            self.status = "part" if self.lost else "seen"
            self._stand(counts, passed)
        self._follow(turns, passed)
        return self._positions.copy(), np.array([*self._place, *Rotation.from_matrix(self._root).as_quat()])

    def facing(self, points: np.ndarray) -> tuple[np.ndarray, bool]:
        """How trunks of a clip (T, K, 3) stand, the median direction (3,), and whether most noses point backwards."""
        if points.shape[1:] != (self._count, 3):
            raise MotionError(f"points have shape {points.shape}; expected (T, {self._count}, 3), one for each name")
        at = np.append(points, np.full((len(points), 1, 3), np.nan), axis=1)[:, self._columns] @ self._axes.T
        left, up = at[:, 5] - at[:, 6], at[:, SHOULDERS].mean(axis=1) - at[:, HIPS].mean(axis=1)
        ahead = (np.cross(left, up) * (at[:, 0] - at[:, EARS].mean(axis=1))).sum(axis=1)
        stands = np.median(up[np.isfinite(up).all(axis=1)], axis=0) if np.isfinite(up).all(axis=1).any() else Z
        return stands, bool((ahead < 0).sum() > 2 * (ahead > 0).sum())

    def to_json(self) -> str:
        """MediaPipe's reader in numbers, for one in another language: native/web/landmarks.js."""
        table = {name: globals()[name.upper()] for name in NUMBERS}
        parts = [name.partition(".")[0] for name in USED]
        table |= {"axes": self._axes.ravel(), "columns": self._columns, "least_confidence": self._least}
        table["soles"] = [[row, SOLE[part]] for row, part in enumerate(parts) if part in SOLE]
        table |= {"chains": [SPINE, NECK], "limbs": [limb.numbers() for limb in self._limbs]}
        table["balls"] = {bone: ball_entry(ball, np.eye(3)) for bone, ball in self._balls.items()}
        return json.dumps(table, default=lambda array: array.tolist(), separators=(",", ":"))

    def _measured(self, found: np.ndarray, seen: np.ndarray) -> bool:
        """Take the person's size; ends of limbs that it makes implausible are not seen. Whether the size is known."""
        halves = [half for limb in self._limbs for half in limb.halves if seen[half[0]] and seen[half[1]]]
        if not self._sizes and not halves:  # no limb yet
            halves = [(hip, hip - 2, UP[2]) for hip in (7, 8) if seen[hip] and seen[hip - 2]]
        sizes = [float(np.linalg.norm(found[b] - found[a])) / length for a, b, length in halves]
        if sizes and (size := float(np.median(sizes))) > 0:
            self._sizes.append(size)
        self._size = float(np.median(self._sizes)) if self._sizes else np.nan
        for (_, end, _), size in zip(halves, sizes):
            seen[end] &= PLAUSIBLE[0] < size / self._size < PLAUSIBLE[1]
        return bool(self._sizes)

    def _in_space(self, found: np.ndarray, seen: np.ndarray) -> np.ndarray:
        """Landmarks whose depth is guessed from one picture: what a forearm lacks in length is depth, where it clearly
        points towards the camera or from it. Who stands has the shoulders above the feet, in the median of frames,
        however the camera is tilted."""
        for _, elbow, wrist in (limb.rows for limb in self._limbs if "arm" in limb.name):
            if seen[elbow] and seen[wrist]:
                ahead, left, up = found[wrist] - found[elbow]
                self._forearms.append(float(np.linalg.norm([ahead, left, up])))
                length = sorted(self._forearms)[3 * len(self._forearms) // 4]  # depth is rather lost than added
                deep = np.sqrt(max(length**2 - left**2 - up**2, ahead**2))
                if abs(ahead) > CLEARLY * length:
                    found[wrist, 0] += np.copysign(deep, ahead) - ahead
        up, hips = found[SHOULDERS].mean(axis=0) - found[FEET].mean(axis=0), found[HIPS].mean(axis=0)
        if up[2] > STANDS and np.linalg.norm(hips) < 0.1 and seen[TRUNK].all() and seen[FEET].all():
            self._leans.append(float(np.arctan2(up[0], up[2])))
        return found @ axis_rotation(Y, np.median(self._leans or [0.0], axis=0))

    def _smooth(self, found: np.ndarray, seen: np.ndarray, passed: float) -> np.ndarray:
        """Smooth landmarks, from the middle of the hips, and that itself. Which of them count."""
        trunk = np.flatnonzero(seen[TRUNK]) + TRUNK.start
        hips = found[HIPS].mean(axis=0) if seen[HIPS].all() else (found - self._value[:-1])[trunk].mean(axis=0)
        here, now = np.array([*(found - hips), hips]), np.append(seen, True)[:, None]
        since = np.maximum(self._time - self._at, 1e-6)
        speed = self._speed + _let_through(SPEED_HZ, since) * ((here - self._value) / since - self._speed)
        cutoff = SLOWEST_HZ + HZ_A_SPEED * np.linalg.norm(speed, axis=1, keepdims=True)
        self._speed = np.where(now, speed, self._speed * np.exp(-passed / CARRY))
        smooth = self._value + _let_through(cutoff, since) * (here - self._value)
        self._value = np.where(now, smooth, self._value + self._speed * passed)
        self._at = np.where(now, self._time, self._at)
        counts = self._time - self._at[:-1, 0] < RECENT
        if not counts[HIPS].any():
            shoulders = self._value[SHOULDERS]
            below = (STANDING[2:] - UP) @ _turn((shoulders[0] - shoulders[1]) * [1, 1, 0], Z, Y, Z).T
            self._value[HIPS] += (shoulders.mean(axis=0) + below - self._value[HIPS]) * (1 - np.exp(-passed / EASE))
        counts[TRUNK] = True
        return counts

    def _turns(self, seen: np.ndarray, memory: float) -> tuple[dict[str, np.ndarray], list[str]]:
        """Rotations (3, 3) of the rig's bones from their parents, of "root" from the world; which parts are lost."""
        at = self._value
        up = at[SHOULDERS].mean(axis=0) - at[HIPS].mean(axis=0)
        root, chest = (_turn(at[pair][0] - at[pair][1], up, Y, UP) for pair in (HIPS, SHOULDERS))
        turns = {"root": root} | dict.fromkeys(SPINE, _part(root.T @ chest, 1 / 3))
        lost = [limb.name for limb in self._limbs if not seen[limb.rows[:3]].all()]
        if seen[FACE].all():
            ahead = at[:3].mean(axis=0) - at[EARS].mean(axis=0)
            head = _turn(at[EARS][0] - at[EARS][1], ahead, Y, AHEAD)
            turns |= dict.fromkeys(NECK, _part(chest.T @ head, 1 / 3))
        elif (self._columns[FACE] < self._count).all():
            lost.append("head")
        for limb in self._limbs:
            turns |= limb.turns(at, seen, chest if "arm" in limb.name else root, self._hinges, memory)
        return turns, lost

    def _stand(self, seen: np.ndarray, passed: float) -> None:
        """Place the root: the lowest foot is on the floor, or the floor where the lowest foot was of late."""
        hips, feet = self._value[-1], [name.partition(".")[0] for name in USED]
        placed = np.linalg.norm(hips) > 0.1
        below = [self._value[row, 2] - SOLE[part] for row, part in enumerate(feet) if part in SOLE and seen[row]]
        lowest = hips[2] + min(below, default=-self._place[2])
        rise = lowest - self._floor
        self._floor = lowest - rise * np.exp(-passed / SINK) if placed and rise > 0 else lowest
        self._place = np.array([*(hips[:2] * placed), hips[2] - self._floor])

    def _follow(self, turns: dict[str, np.ndarray], passed: float) -> None:
        """Joints and root follow their rotations; the others are held, then eased to rest."""
        now = np.array([bone in turns for bone in self._bones])
        first = not np.isfinite(self._seen_at).any()
        self._trust = np.where(first & now, 1, np.clip(self._trust + np.where(now, passed, -passed) / TRUST, 0, 1))
        self._seen_at[now] = self._time
        eased = np.where(self._time - self._seen_at > HELD, 1 - np.exp(-passed / EASE), 0.0)
        share = np.where(now, self._trust, eased)
        upright = smallest_rotation(self._root @ Z, Z) @ self._root
        self._root = self._root @ _part(self._root.T @ turns.get("root", upright), share[-1])
        every = np.array([turns.get(bone, np.eye(3)) for bone in self._bones[:-1]])
        wanted = np.zeros(len(self._positions))
        self._solver.solve(every, wanted)
        middle = (self._rig.lower + self._rig.upper) / 2
        wanted = middle + (self._rig.rest + wanted - middle + np.pi) % (2 * np.pi) - np.pi
        wanted = np.clip(wanted, self._rig.lower, self._rig.upper)
        moved = self._solver.targets
        self._positions[moved] += share[self._solver.owners] * (wanted - self._positions)[moved]


LIMBS = {  # landmarks, bones, axes of the ball joint, the joint that shares its twist, axis of the hinge
    "arm": (("shoulder", "elbow", "wrist"), ("upperarm01", "lowerarm01", "wrist"), "xyz", "upperarm02.{}_y", "z"),
    "leg": (("hip", "knee", "ankle"), ("upperleg01", "lowerleg01", "foot"), "yxz", "upperleg02.{}_z", "y"),
}


class _Limb:
    """An arm or a leg: rows of its landmarks and, at rest, where its halves point and the axis that it bends about."""

    def __init__(self, rig: Rig, limb: str, side: str) -> None:
        parts, bones, ball, half, hinge = LIMBS[limb]
        letter = side[0].upper()
        self.name, mirrored = f"{side} {limb}", np.array([1, -1 if side == "left" else 1, 1])
        self._heel_to_toe, self._ankle_to_toe = HEEL_TO_TOE * mirrored, ANKLE_TO_TOE * mirrored
        self.bones = upper, middle, end = [f"{bone}.{letter}" for bone in bones]
        self.rows = [USED.index(f"{part}.{letter}") for part in (*parts, *(("heel", "toe") * (limb == "leg")))]
        twist = half.format(letter)
        self.joints = {upper: ([f"{upper}_{axis}" for axis in ball], twist), middle: ([f"{middle}_{hinge}"], "")}
        if limb == "leg":
            self.joints[end] = ([f"{end}_y", f"{end}_z"], "")
        joint = rig.joint_indices[f"{middle}_{hinge}"]
        self._axis = rig.dof_axes[joint] * np.sign(rig.lower[joint] + rig.upper[joint])
        heads = rig.heads[[rig.bone_index(bone) for bone in self.bones]]
        lengths = np.linalg.norm(np.diff(heads, axis=0), axis=1)
        self.halves = [(*self.rows[:2], lengths[0]), (*self.rows[1:3], lengths[1])]
        self._upper, self._lower = np.diff(heads, axis=0) / lengths[:, None]
        # The cosine between the halves is constant + reach * cos(angle - straight).
        self._constant = (self._axis @ self._lower) * (self._axis @ self._upper)
        sine, cosine = self._upper @ np.cross(self._axis, self._lower), self._upper @ self._lower - self._constant
        self._straight, self._reach = np.arctan2(sine, cosine), np.hypot(sine, cosine)

    def numbers(self) -> dict[str, Any]:
        """All of it, by name."""
        return {name.lstrip("_"): value for name, value in vars(self).items() if name != "joints"}

    def turns(
        self, at: np.ndarray, seen: np.ndarray, carrier: np.ndarray, hinges: dict[str, np.ndarray], memory: float
    ) -> dict[str, np.ndarray]:
        """Rotations (3, 3) of its bones from their parents. hinges: axes about which limbs bend, seen from what carries
        them (3, 3); kept. memory: what that of before counts."""
        a, b, c, *foot = self.rows
        upper, lower = _unit(at[b] - at[a]), _unit(at[c] - at[b])
        if not (seen[a] and seen[b] and upper.any()):
            return {}
        natural = smallest_rotation(self._upper, carrier.T @ upper) @ self._axis
        axis = carrier @ (memory * hinges.get(self.name, natural) + NATURAL * natural)
        at_rest, bend = (memory + NATURAL) * self._axis, None
        if seen[c] and lower.any():
            angle = np.arccos(np.clip((upper @ lower - self._constant) / self._reach, -1, 1))
            bend = axis_rotation(self._axis, self._straight + angle)
            axis, at_rest = axis + _cross(upper, lower), at_rest + _cross(self._upper, bend @ self._lower)
        above = _turn(upper, axis, self._upper, at_rest)
        hinges[self.name] = carrier.T @ above @ self._axis
        turns = {self.bones[0]: carrier.T @ above}
        if bend is not None:
            turns[self.bones[1]] = bend
            if foot and seen[foot[1]]:
                start, sole = (foot[0], self._heel_to_toe) if seen[foot[0]] else (c, self._ankle_to_toe)
                shin = above @ bend
                turns[self.bones[2]] = shin.T @ _turn(at[foot[1]] - at[start], shin @ Y, sole, Y)
        return turns


def _axes(text: str) -> np.ndarray:
    """(3, 3) ours <- the tracker's. Raises MotionError."""
    words = text.split()
    if sorted(word[-1:] for word in words) != ["x", "y", "z"] or any(word[:-1] not in ("", "-") for word in words):
        raise MotionError(f'axes are {shown(text)}; expected those that point forward, left and up, such as "-z x -y"')
    return np.array([np.eye(3)["xyz".index(word[-1])] * (-1 if word[0] == "-" else 1) for word in words])


def _let_through(cutoff_hz: float | np.ndarray, passed: np.ndarray) -> np.ndarray:
    """The share of a change that a first-order filter lets through after a time."""
    return 1 / (1 + 1 / (2 * np.pi * cutoff_hz * passed))


def _unit(vector: np.ndarray) -> np.ndarray:
    """Of length 1, or 0."""
    return vector / (np.sqrt(vector @ vector) or 1.0)


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Of two vectors (3,); NumPy's takes three times as long."""
    (x, y, z), (u, v, w) = a.tolist(), b.tolist()
    return np.array([y * w - z * v, z * u - x * w, x * v - y * u])


def _turn(first: np.ndarray, second: np.ndarray, first_rest: np.ndarray, second_rest: np.ndarray) -> np.ndarray:
    """The rotation (3, 3) that takes two directions at rest to those that are seen, the first exactly."""
    frames = []
    for one, two in ((first, second), (first_rest, second_rest)):
        one = _unit(one) if one.any() else X
        across = _cross(one, two)
        across = _unit(across if across @ across > 1e-18 else _cross(one, np.eye(3)[np.abs(one).argmin()]))
        frames.append(np.array([one, _cross(across, one), across]))
    return frames[0].T @ frames[1]


def _part(turn: np.ndarray, share: float) -> np.ndarray:
    """A share of a rotation (3, 3); none of half a turn, whose axis is not known."""
    axis = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    return axis_rotation(_unit(axis), share * np.arctan2(np.linalg.norm(axis), np.trace(turn) - 1))
