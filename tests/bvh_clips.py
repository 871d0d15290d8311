"""A small BVH file, written as exporters write it."""

from __future__ import annotations

# name, parent, offset from the parent (Y up, looks along Z, left is X), arms stretched out sideways
JOINTS = [
    ("Hips", None, (0, 0, 0)),
    ("Spine1", "Hips", (0, 20, 0)),
    ("Head", "Spine1", (0, 30, 0)),
]
for _side, _x in (("Left", 1), ("Right", -1)):
    JOINTS += [
        (f"{_side}UpLeg", "Hips", (10 * _x, -5, 0)),
        (f"{_side}Leg", f"{_side}UpLeg", (0, -45, 0)),
        (f"{_side}Foot", f"{_side}Leg", (0, -45, 0)),
        (f"{_side}Arm", "Spine1", (20 * _x, 25, 0)),
        (f"{_side}ForeArm", f"{_side}Arm", (30 * _x, 0, 0)),
        (f"{_side}Hand", f"{_side}ForeArm", (25 * _x, 0, 0)),
    ]


def write_bvh(path, frames, *, rate=60, joints=JOINTS, renamed=lambda name: name):
    """frames: joint -> degrees about Z, X and Y (intrinsic), others at rest; `position` of the hips."""
    children = {name: [child for child, parent, _ in joints if parent == name] for name, *_ in joints}
    offset = {name: offset for name, _, offset in joints}
    order, lines = [], ["HIERARCHY"]

    def joint(name, keyword):
        order.append(name)
        kept = "Xposition Yposition Zposition " if keyword == "ROOT" or name == "Hips" else ""
        channels = f"CHANNELS {6 if kept else 3} {kept}Zrotation Xrotation Yrotation"
        lines.extend([f"{keyword} {renamed(name)}", "{", "OFFSET {} {} {}".format(*offset[name]), channels])
        for child in children[name]:
            joint(child, "JOINT")
        if not children[name]:
            lines.extend(["End Site", "{", "OFFSET 0 5 0", "}"])
        lines.append("}")

    joint(joints[0][0], "ROOT")
    lines += ["MOTION", f"Frames: {len(frames)}", f"Frame Time: {1 / rate}"]
    for frame in frames:
        values = []
        for name in order:
            if name == "Hips":
                values += frame.get("position", (0, 95, 0))
            elif name == order[0]:
                values += (0, 0, 0)
            values += frame.get(name, (0, 0, 0))
        lines.append(" ".join(map(str, values)))
    path.write_text("\n".join(lines) + "\n")
    return path


# Left arm hangs and its elbow bends forward by a right angle; the right one hangs; the right knee is pulled up.
POSE = {
    "LeftArm": (-80, 0, 0),
    "LeftForeArm": (0, 0, -90),
    "RightArm": (80, 0, 0),
    "RightUpLeg": (0, -60, 0),
    "RightLeg": (0, 60, 0),
}
