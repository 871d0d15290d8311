"""Files with clips, as tools write them, of the person and the frames of `test_mocap`: Y up, facing Z, in a T-pose."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from physkin_core.formats.gltf_builder import GltfBuilder, write_glb

SMPL_JOINTS = {"Hips": 0, "LeftUpLeg": 1, "RightUpLeg": 2, "LeftLeg": 4, "RightLeg": 5, "LeftFoot": 7, "RightFoot": 8}
SMPL_JOINTS |= {"Spine1": 9, "Head": 15, "LeftArm": 16, "RightArm": 17, "LeftForeArm": 18, "RightForeArm": 19}
SMPL_JOINTS |= {"LeftHand": 20, "RightHand": 21}


def turns_of(frames, name):
    """Rotations of a joint on its parent."""
    return Rotation.from_euler("ZXY", [frame.get(name, (0, 0, 0)) for frame in frames], degrees=True)


def places_of(frames):
    return np.array([frame.get("position", (0, 95, 0)) for frame in frames], dtype=np.float64)


def write_gltf_clips(
    path, joints, clips, *, rate=60, how="LINEAR", renamed=lambda name: name, armature=None, change=None
):
    """A GLB with a clip for each name and frames. armature: rotation and scale of a node above the hips, which has a
    skin: mesh space is within it, and nodes are kept in the last frame. change: what else is done to the builder."""
    builder = GltfBuilder({"version": "2.0"})
    number = {name: k for k, (name, *_) in enumerate(joints)}
    heads = {}
    for name, parent, offset in joints:
        heads[name] = np.array(offset, dtype=np.float64) + (heads[parent] if parent else 0)
    nodes = [{"name": renamed(name), "translation": list(map(float, offset))} for name, _, offset in joints]
    for name, parent, _ in joints:
        if parent:
            nodes[number[parent]].setdefault("children", []).append(number[name])
    turn, scale = armature or (Rotation.identity(), 1.0)
    within = turn.inv().as_matrix() / scale  # armature space <- scene
    if armature is not None:
        nodes.append({"name": "Armature", "children": [0], "scale": [scale] * 3, "rotation": turn.as_quat().tolist()})
        inverse = np.tile(np.eye(4, dtype=np.float32), (len(joints), 1, 1))
        for name, k in number.items():
            inverse[k, :3, :3] = np.linalg.inv(within)
            inverse[k, :3, 3] = -heads[name]
        stored = builder.add_accessor(inverse.transpose(0, 2, 1).reshape(-1, 16).astype(np.float32))
        builder.document["accessors"][stored]["type"] = "MAT4"
        builder.document["skins"] = [{"joints": list(range(len(joints))), "inverseBindMatrices": stored}]
        last = list(clips.values())[0][-1:]
        for name, k in number.items():
            nodes[k]["rotation"] = turns_of(last, name).as_quat()[0].tolist()
        nodes[0]["rotation"] = (turn.inv() * turns_of(last, "Hips")).as_quat()[0].tolist()
        nodes[0]["translation"] = (within @ places_of(last)[0]).tolist()
        nodes[0]["scale"] = [1 / scale] * 3
    animations = []
    for clip, frames in clips.items():
        times = builder.add_accessor((np.arange(len(frames)) / rate).astype(np.float32)[:, None])
        animation = {"name": clip, "channels": [], "samplers": []}
        for name, k in number.items():
            turns = turns_of(frames, name)
            if name == "Hips":
                values = {"translation": places_of(frames) @ within.T, "rotation": (turn.inv() * turns).as_quat()}
            else:
                values = {"rotation": turns.as_quat()}
            for part, keys in values.items():
                if how == "CUBICSPLINE":
                    keys = np.stack([0 * keys, keys, 0 * keys], axis=1).reshape(-1, keys.shape[1])
                sampler = {
                    "input": times,
                    "output": builder.add_accessor(keys.astype(np.float32)),
                    "interpolation": how,
                }
                target = {"node": k, "path": part}
                animation["channels"].append({"sampler": len(animation["samplers"]), "target": target})
                animation["samplers"].append(sampler)
        animations.append(animation)
    roots = [len(joints)] if armature else [0]
    builder.document |= {"nodes": nodes, "animations": animations, "scene": 0, "scenes": [{"nodes": roots}]}
    if change is not None:
        change(builder.document)
    write_glb(path, builder)
    return path


def smpl_arrays(frames, *, width=156, rate=120.0, up="Z"):
    """What AMASS has in a file: the world is Z up, so that the pelvis turns the body, which rests Y up."""
    to_world = Rotation.from_euler("x", 90 if up == "Z" else 0, degrees=True)
    poses = np.zeros((len(frames), width))
    for name, joint in SMPL_JOINTS.items():
        turns = turns_of(frames, name)
        poses[:, 3 * joint : 3 * joint + 3] = (to_world * turns if joint == 0 else turns).as_rotvec()
    trans = to_world.apply(places_of(frames) / 100)
    return {"poses": poses, "trans": trans, "mocap_framerate": rate, "gender": "neutral", "betas": np.zeros(16)}
