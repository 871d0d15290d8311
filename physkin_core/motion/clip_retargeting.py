"""Retargeting of a clip of any skeleton: which joint is which, how they turn, and the motion of the default rig.

Which way the skeleton looks is read off its hips and spine at rest, or, where its rest is no standing body, in the
clip's most upright frame. Elbow and knee axes are those about which the clip bends them, as files do not agree on where
arms and palms are at rest.

Dimensions: `T` frames, `J` joints. Offsets in the file's own unit: a clip is scaled by the length of its legs.
"""

from __future__ import annotations

import logging
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from physkin_core.avatar.body_model import load_body_model
from physkin_core.file_reading import ContentError
from physkin_core.motion.calibration_pose import calibration_frames
from physkin_core.motion.limb_ends import limb_towards
from physkin_core.motion.motion import Motion
from physkin_core.motion.retargeting import leg_length, on_floor, retarget
from physkin_core.motion.source_clip import RATE_HZ, SourceClip
from physkin_core.progress import Watch
from physkin_core.rig.human_skeleton import find_human_skeleton
from physkin_core.rig.rig import Rig, ancestors

__all__ = ["find_joints", "retarget_clip"]

log = logging.getLogger(__name__)

HINGE_GUESS = 0.05  # how much a T-pose's elbow and knee axes count beside those seen in the clip
ALONG_AXIS = 0.97  # cosine from which on hips lie along an axis: few bodies are quite symmetric
RAISED = 0.5  # cosine to the vertical from which on a limb or the trunk stands
TRUNK_AND_LEGS = (("neck", "root"), ("hip.L", "ankle.L"), ("hip.R", "ankle.R"))
PARTS = {"hip": "upperleg01", "knee": "lowerleg01", "ankle": "foot"}
PARTS |= {"shoulder": "upperarm01", "elbow": "lowerarm01", "wrist": "wrist"}
"""The rig's bone that begins at a joint of a limb."""


def retarget_clip(
    clip: SourceClip, rig: Rig, *, subject: str, name: str, watch: Watch = lambda share: None
) -> tuple[Motion, dict[str, float]]:
    """The clip as motion of the default rig at 60 Hz, standing on the floor and facing X at first.

    rig: the default one. subject: the file, for warnings. name: of the motion. watch: told the share done. Frames of a
    calibration pose before the motion are left out, with a warning.
    Also returns the mean angle [degrees] between a bone's direction and the source's, by rig bone.
    Raises ContentError for a limb that is not recognised.
    """
    joints, remarks = find_joints(clip)
    for remark in remarks:
        log.warning("%s: %s", subject, remark)
    calibration, limbs = calibration_frames(clip, joints)
    if calibration:
        said = "%s: its first %d frames are left out: a calibration pose (%s)"
        log.warning(said, subject, calibration, ", ".join(limbs))
        clip = clip.at(slice(calibration, None))
    clip = clip.at(slice(None, None, max(1, round(clip.rate_hz / RATE_HZ))))
    rotations, positions = _hanging(clip, joints, rig, subject)
    joint_positions, report = retarget(rig, rotations, watch=watch)
    root = rotations["root"]
    forward = root[0].apply([1.0, 0.0, 0.0])
    ahead = Rotation.from_euler("z", -np.arctan2(forward[1], forward[0]))
    positions = ahead.apply(positions - positions[0] * [1, 1, 0])
    motion = Motion(rig.joint_names, joint_positions, (ahead * root).as_quat(), positions, clip.rate_hz, name)
    return on_floor(motion.resampled(RATE_HZ)), {bone: report[bone][0] for bone in report if bone in rig.bone_names}


def _hanging(clip: SourceClip, joint: dict[str, int], rig: Rig, subject: str) -> tuple[dict[str, Rotation], np.ndarray]:
    """What `retarget` wants: rotations by its joints; also root positions (T, 3) [m], Z up.

    Arms of the rig end where the source's do, seen from the shoulder and as a share of their length. Hips, and feet
    seen from them, are where they are in the source, as a share of the legs' length: feet that stand do not slide.
    """
    posed = {part: clip.turned(index) for part, index in joint.items()}
    at_rest = {part: clip.rest[index] for part, index in joint.items()}
    places = {part: clip.places[:, index] for part, index in joint.items()}
    up = _nearest_axis(at_rest["neck"] - at_rest["root"])
    if not all(_unit(at_rest[top] - at_rest[end]) @ up > RAISED for top, end in TRUNK_AND_LEGS):  # it does not stand
        posed, at_rest = _from_upright(posed, places)
        up = _nearest_axis(at_rest["neck"] - at_rest["root"])
    across = at_rest["hip.L"] - at_rest["hip.R"]
    left = _unit(across - up * (across @ up))
    left = _nearest_axis(left) if left @ _nearest_axis(left) > ALONG_AXIS else left
    toes = sum((at_rest[f"toe.{side}"] - at_rest[f"ankle.{side}"] for side in "LR" if f"toe.{side}" in joint), 0 * up)
    if toes @ np.cross(left, up) < -RAISED * np.linalg.norm(toes):
        log.warning("%s: it is mirrored, as toes point backwards; what its mirror image does is taken", subject)
        turns, rest, heads = clip.rotations * [1, -1, -1, 1], clip.rest * [-1, 1, 1], clip.places * [-1, 1, 1]
        return _hanging(replace(clip, rotations=turns, rest=rest, places=heads), joint, rig, subject)
    turn = np.stack([np.cross(left, up), left, up])  # ours <- source
    to_ours = Rotation.from_matrix(turn)
    at_rest = {part: turn @ head for part, head in at_rest.items()}
    places = {part: place @ turn.T for part, place in places.items()}
    turned = {part: to_ours * rotation * to_ours.inv() for part, rotation in posed.items()}
    head = dict(zip(rig.bone_names, rig.heads))

    rotations = {part: turned[part] for part in ("root", "chest", "neck", "clavicle.L", "clavicle.R")}
    rotations |= {part: turned[part] for part in ("ankle.L", "ankle.R")}
    root, ahead = turned["root"], (places["hip.L"] + places["hip.R"]) / 2
    middle = (head["upperleg01.L"] + head["upperleg01.R"]) / 2
    scale = leg_length(rig) / np.mean([_limb_length(at_rest, "hip", "knee", "ankle", side) for side in "LR"])
    for side in "LR":
        # elbows bend forwards, knees backwards: about -Y and +Y of a limb that hangs
        for first, second, end, sense in (("shoulder", "elbow", "wrist", -1), ("hip", "knee", "ankle", 1)):
            parts = [f"{part}.{side}" for part in (first, second, end)]
            own = [head[f"{PARTS[part]}.{side}"] for part in (first, second, end)]
            lengths = [float(np.linalg.norm(own[1] - own[0])), float(np.linalg.norm(own[2] - own[1]))]
            above = turned[parts[0]]
            upper, lower = (_unit(at_rest[b] - at_rest[a]) for a, b in zip(parts, parts[1:]))
            along = [above.apply(upper), turned[parts[1]].apply(lower)]
            seen = above.inv().apply(sense * np.cross(along[0], along[1])).mean(axis=0)
            guess = Rotation.align_vectors([upper], [[0.0, 0.0, -1.0]])[0].apply([0.0, 1.0, 0.0])
            hinge = above.apply(_unit(seen + HINGE_GUESS * guess))
            if first == "hip":
                reach = scale * (places[parts[2]] - ahead) - root.apply(own[0] - middle)
            else:
                share = sum(lengths) / _limb_length(at_rest, first, second, end, side)
                reach = share * (places[parts[2]] - places[parts[0]])
            for part, direction in zip(parts, limb_towards(reach, along[0], sense * hinge, *lengths)):
                axis = hinge - direction * (hinge * direction).sum(axis=1, keepdims=True)
                axis /= np.maximum(np.linalg.norm(axis, axis=1, keepdims=True), 1e-9)
                columns = [np.cross(axis, -direction), axis, -direction]  # images of X, Y, Z
                rotations[part] = Rotation.from_matrix(np.stack(columns, axis=-1))
    return rotations, scale * ahead - root.apply(middle)


def _limb_length(heads: dict[str, np.ndarray], first: str, second: str, end: str, side: str) -> float:
    upper, middle, lower = (heads[f"{part}.{side}"] for part in (first, second, end))
    return float(np.linalg.norm(middle - upper) + np.linalg.norm(lower - middle))


def _from_upright(
    posed: dict[str, Rotation], heads: dict[str, np.ndarray]
) -> tuple[dict[str, Rotation], dict[str, np.ndarray]]:
    """Rotations (T) from the clip's most upright frame, turned to look along an axis, and joints (3,) in it.

    Stands in for the rest of files whose offsets lie along the bones, whichever way these point.
    """
    trunk = heads["neck"] - heads["root"]
    up = _nearest_axis(trunk.mean(axis=0))
    pairs = (("hip", "knee"), ("knee", "ankle"))
    bones = [heads[f"{above}.{side}"] - heads[f"{below}.{side}"] for side in "LR" for above, below in pairs]
    upright = sum((bone / np.linalg.norm(bone, axis=1, keepdims=True)) @ up for bone in (trunk, trunk, *bones))
    frame = int(np.argmax(upright))
    left = heads["hip.L"][frame] - heads["hip.R"][frame]
    left -= up * (left @ up)
    ahead = Rotation.align_vectors([_nearest_axis(left), up], [_unit(left), up])[0]
    turned = {part: rotation * rotation[frame].inv() * ahead.inv() for part, rotation in posed.items()}
    return turned, {part: ahead.apply(head[frame] - heads["root"][frame]) for part, head in heads.items()}


def _nearest_axis(vector: np.ndarray) -> np.ndarray:
    axis = np.zeros(3)
    largest = np.abs(vector).argmax()
    axis[largest] = np.sign(vector[largest])
    return axis


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / max(float(np.linalg.norm(vector)), 1e-12)


def find_joints(clip: SourceClip) -> tuple[dict[str, int], tuple[str, ...]]:
    """Joint index of `root`, `chest`, `neck`, and `hip`, `knee`, `ankle`, `clavicle` (the chest's in a skeleton without
    one), `shoulder`, `elbow`, `wrist` with `.L`, `.R`; and what was assumed.

    Pelvis and chest are where legs and arms branch. Raises ContentError for a part that no joint was recognised as.
    """
    names, rig = clip.names, load_body_model().rig
    human = find_human_skeleton(names, clip.parents, clip.rest, rig, humanoid=clip.humanoid, by_hand=clip.by_hand)
    if human.missing:
        raise ContentError(human.refusal(names, rig))
    found = {f"{part}.{side}": human.joints[f"{bone}.{side}"] for part, bone in PARTS.items() for side in "LR"}
    for side in "LR":
        away = np.linalg.norm(clip.rest - clip.rest[found[f"ankle.{side}"]], axis=1)
        away[clip.parents != found[f"ankle.{side}"]] = 0
        found |= {f"toe.{side}": int(away.argmax())} if away.any() else {}
    found["root"] = _branching(clip, found["hip.L"], found["hip.R"])
    found["chest"] = _branching(clip, found["shoulder.L"], found["shoulder.R"])
    found["neck"] = next((human.joints[bone] for bone in ("head", "neck01") if bone in human.joints), found["chest"])
    if found["neck"] == found["root"]:
        raise ContentError(f"it has no joint for neck, head or chest; joints are {', '.join(names)}")
    if found["chest"] == human.joints.get("neck01"):  # 3ds Max's bipeds hang their collarbones on it
        found["chest"] = int(clip.parents[found["chest"]])
    found |= {f"clavicle.{side}": human.joints.get(f"clavicle.{side}", found["chest"]) for side in "LR"}
    return found, human.remarks(names)


def _branching(clip: SourceClip, first: int, second: int) -> int:
    """The last joint that carries both."""
    return max(set(ancestors(clip.parents, first)) & set(ancestors(clip.parents, second)))
