"""ASF/AMC files: a skeleton of bones, and the values of their channels in each frame.

Lengths in the file's own unit, angles in degrees unless the skeleton says radians.
"""

from __future__ import annotations

from array import array
from collections.abc import Collection

import numpy as np
from scipy.spatial.transform import Rotation

from physkin_core.file_reading import ContentError, numbers_of, shown, with_decimal_points
from physkin_core.motion.source_clip import SourceClip, check_clip_size, posed_clip

__all__ = ["AMC_RATE_HZ", "read_amc"]

AMC_RATE_HZ = 120.0
"""An AMC file does not state its rate; this is that of the CMU database."""


def read_amc(text: str, asf: str) -> SourceClip:
    """The clip of an AMC file and its skeleton, as if recorded at `AMC_RATE_HZ`. Raises ContentError, with the line of
    the AMC, ValueError, IndexError or KeyError where one is none."""
    bones: dict[str, dict[str, list[str]]] = {"root": {}}
    for block in asf.partition(":bonedata")[2].partition(":hierarchy")[0].split("begin")[1:]:
        words = [with_decimal_points(line).split() for line in block.split("\n") if line.strip()]
        fields = {keyword.lower(): values for keyword, *values in filter(None, words)}
        if lacking := [key for key in ("name", "direction", "length", "axis") if not fields.get(key)]:
            raise ContentError(
                f"its skeleton's bone {shown(' '.join(fields.get('name', ['?'])))} lacks {', '.join(lacking)}"
            )
        bones[fields["name"][0]] = fields
    parent_of = _parents(asf.partition(":hierarchy")[2], bones)
    in_degrees = "rad" not in asf.partition(":units")[2].partition(":")[0].lower().split()
    order = asf.partition(":root")[2].partition("order")[2].split("\n")[0].upper().split()
    channels_of = {name: bones[name].get("dof", []) if parent else order for name, parent in parent_of.items()}
    frames = {name: array("d") for name, channels in channels_of.items() if channels}
    count = 0
    for number, line in enumerate(text.split("\n"), 1):
        name, *words = with_decimal_points(line).split() or [""]
        if name in frames:
            frames[name].extend(numbers_of(words, len(channels_of[name]), number))
        elif not words and name.isdigit():
            count += 1
    check_clip_size(count, len(parent_of), AMC_RATE_HZ)
    index = {name: k for k, name in enumerate(parent_of)}
    offsets, turns, root_places = np.zeros((len(index), 3)), [], None
    for joint, (name, parent) in enumerate(parent_of.items()):
        fields, channels = bones[name], channels_of[name]
        values = np.array(frames[name]).reshape(-1, len(channels)) if channels else np.empty((count, 0))
        if not len(values) == count > 0:
            raise ContentError(f"{shown(name)} has values in {len(values)} of {count} frames, expected all, and some")
        if not parent:
            angles, places = ([order.index(f"{kind}{axis}") for axis in "XYZ"] for kind in "RT")
            turns.append(Rotation.from_euler("xyz", values[:, angles], degrees=in_degrees))
            root_places = values[:, places]
            continue
        if parent != "root":  # a bone starts where its parent ends
            length = float(bones[parent]["length"][0])
            offsets[joint] = [length * float(v) for v in bones[parent]["direction"]]
        axes = Rotation.from_euler(
            fields["axis"][3].lower(), [float(v) for v in fields["axis"][:3]], degrees=in_degrees
        )
        letters = "".join(channel[1].lower() for channel in channels)
        turned = Rotation.from_euler(letters, values, degrees=in_degrees) if channels else Rotation.identity(count)
        turns.append(axes * turned * axes.inv())
    parents = [index.get(parent, -1) for parent in parent_of.values()]
    return posed_clip(list(index), parents, offsets, turns, {0: root_places}, count, AMC_RATE_HZ)


def _parents(hierarchy: str, bones: Collection[str]) -> dict[str, str]:
    """The parent of each bone by name, parents first; that of the root is empty."""
    parent_of = {"root": ""}
    for line in hierarchy.split("\n"):
        parent, *children = line.split() or [""]
        if parent not in bones:
            continue
        if parent not in parent_of:
            raise ContentError(f"its hierarchy hangs bones on {shown(parent)}, which no line before hangs on another")
        for child in children:
            if child not in bones or child in parent_of:
                raise ContentError(
                    f"its hierarchy hangs {shown(child)} on {shown(parent)}; allowed are bones of :bonedata, each "
                    "once, and no circle"
                )
            parent_of[child] = parent
    return parent_of
