"""Rig files are read from the mesh's own folder, within limits, and refused in a sentence that names what is wrong."""

from __future__ import annotations

import json

import pytest

from physkin_core.avatar.avatar import AvatarError
from physkin_core.avatar.mesh_avatar import load_mesh
from physkin_core.avatar.rig_file import read_rig_file
from physkin_core.file_reading import ContentError

END = {"head": [0, 0, 0], "tail": [0, 0, 1]}
BONE = {"name": "hips", "parent": None, **END}


def test_a_rig_file_is_beside_its_mesh(tmp_path):
    """A link out of the folder is refused."""
    (tmp_path / "folder").mkdir()
    (tmp_path / "secret.json").write_text("{}")
    (tmp_path / "folder" / "me.rig.json").symlink_to(tmp_path / "secret.json")
    (tmp_path / "folder" / "me.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    with pytest.raises(ContentError, match="it names 'me.rig.json', outside the folder that it is in"):
        load_mesh(tmp_path / "folder" / "me.obj", None)


def test_a_file_of_holes_is_not_read(tmp_path):
    """Three gigabytes of it."""
    with open(tmp_path / "me.rig.json", "wb") as file:
        file.truncate(3 << 30)
    with pytest.raises(AvatarError, match="'me.rig.json' has 3221225472 bytes, allowed are 67108864"):
        read_rig_file(tmp_path / "me.rig.json")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("{", "is not JSON"),
        ("[]", "it must be a JSON object"),
        ("[" * 200_000, "is nested too deeply"),
        ('{"scale": 1' + "0" * 400 + "}", "malformed: OverflowError"),
        ({"colour": "red"}, "unknown keys 'colour'; allowed: bones"),
        ({"up": "W"}, "up 'W' and forward None; allowed are two different axes"),
        ({"up": "X", "forward": "-X"}, "two different axes"),
        ({"forward": "X"}, "not what is up"),
        ({"scale": 0}, "scale is 0.0"),
        ({"scale": "big"}, "malformed: ValueError"),
        ({"bones": [{"name": "root"}]}, "malformed: KeyError: 'parent'"),
        ({"bones": [BONE | {"parent": "b"}]}, "malformed: ValueError"),
        ({"bones": [BONE | {"parent": 0}]}, "'hips' has parent 0"),
        ({"bones": [BONE | {"head": [0, 0]}]}, "of bone 'hips' must be 3 finite"),
        ({"bones": [BONE], "influence_bones": [[40]], "influence_weights": [[1.0]]}, "span 40 to 40, allowed 0 to 0"),
        ({"bones": [BONE], "influence_bones": [[0]], "influence_weights": [[-1.0]]}, "not negative"),
        ({"bones": [BONE], "influence_bones": [[0, 1]], "influence_weights": [[1.0]]}, "rows of equal length"),
        ({"bones": [BONE], "influence_bones": [[0]]}, "together or not at all"),
        ({"bones": [BONE | {"name": f"b{k}"} for k in range(60_000)]}, "60000 bones, allowed are 2048"),
        ({"bones": [BONE | {"name": "\x1b[2J\n", "parent": 7}]}, r"bone '\\x1b\[2J\\n' has parent 7"),
        ({f"\x1b{k}" * 1000: 1 for k in range(1000)}, r"unknown keys '\\x1b0.*' and 996 more; allowed: b"),
        (
            {"bones": [BONE], "influence_bones": [[0] * 10**6], "influence_weights": [[1] * 10**6]},
            "a vertex has 1000000 skinning weights, allowed are 16",
        ),
    ],
)
def test_what_is_wrong_is_refused_in_a_sentence(tmp_path, content, message):
    (tmp_path / "me.rig.json").write_text(content if isinstance(content, str) else json.dumps(content))
    with pytest.raises(AvatarError, match=message) as told:
        read_rig_file(tmp_path / "me.rig.json")
    assert len(str(told.value)) <= 300 and str(told.value).isprintable()
