"""Bones file: joints of a skeleton named by hand, where their own names do not say enough; `NAME.bones.json` beside
`NAME.glb`, or any file that is chosen.

A JSON object, bone of the rig -> joint of the skeleton, as in {"upperarm01.L": "my_left_arm"}. What it leaves out, or
has empty, is recognised as ever. Of joint states it names rig joints: {"lowerarm01.L_z": "left_elbow"}.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path

from physkin_core.file_reading import ContentError, file_beside, read_bytes, read_json, reading, shown
from physkin_core.rig.nearest_names import nearest_names

__all__ = ["BonesFileError", "read_bones_file"]

SUFFIX = ".bones.json"
LARGEST_BONES_FILE = 1 << 20  # [bytes]


class BonesFileError(ContentError):
    """A bones file cannot be read, or does not fit the skeleton."""


def read_bones_file(
    chosen: str | Path | None, named: Path, bones: Collection[str], joints: Sequence[str]
) -> dict[str, int]:
    """Index of the joint by bone. chosen: the bones file; None: the one beside the file `named`, if there is one.

    Raises BonesFileError: unreadable, no object, a bone that is none of `bones`, a joint that is none of `joints` or is
    named twice.
    """
    beside = f"{named.stem}{SUFFIX}"
    if chosen is None and not named.with_name(beside).is_file():
        return {}
    path = file_beside(named, beside) if chosen is None else Path(chosen)
    with reading(f"bones file {path}", BonesFileError):
        entries = read_json(read_bytes(path, most=LARGEST_BONES_FILE))
        if not isinstance(entries, dict) or not all(isinstance(joint, str) for joint in entries.values()):
            raise ContentError(f"it holds {shown(entries)}; it must be a JSON object, bone to name of a joint")
        found = {bone: joint for bone, joint in entries.items() if joint}
        for name, known, owner in [(bone, bones, "the rig") for bone in entries] + [
            (joint, joints, named.name) for joint in found.values()
        ]:
            if name not in known:
                near = nearest_names(name, known)
                raise ContentError(f"{owner} has no {shown(name)}; {f'did you mean {near}?' if near else 'mend that'}")
        if twice := [joint for joint in found.values() if list(found.values()).count(joint) > 1]:
            raise ContentError(f"two bones cannot both be {shown(twice[0])}")
    return {bone: joints.index(joint) for bone, joint in found.items()}
