"""Parameters and configuration files: what is asked for is found, what is wrong is named."""

from __future__ import annotations

from pathlib import Path

import pytest
from fuzzing import check_refusals

import physkin_ros
from physkin_ros.node import settings
from physkin_ros.node.config_file import load_config
from physkin_ros.node.settings import SettingsError
from physkin_ros.node.settings_reading import read_settings

CONFIG = Path(settings.__file__).parents[1] / "config"


def write(tmp_path, text: str) -> Path:
    path = tmp_path / "avatars.yaml"
    path.write_text(text)
    return path


@pytest.mark.parametrize("name", ["avatars.yaml", "one_avatar.yaml"])
def test_shipped_configs_are_right(name):
    """Those that users start from."""
    pytest.importorskip("yaml")
    assert load_config(CONFIG / name).avatars


def test_many_avatars(tmp_path):
    """Ids and names become frames and prefixes; whole numbers will do for real ones."""
    pytest.importorskip("yaml")
    path = write(
        tmp_path,
        """
/**:
  ros__parameters:
    use_sim_time: true
    load_timeout: 60
    avatars:
      ann: {cloud_rate: 60, gravity: [0, 1, 0], garments: {top: {model: tshirt}, legs: {model: trousers}}}
      bob: {frame_id: torso, garments: {top: {fit: 0}, legs: {fit: ""}}}
""",
    )
    found = load_config(path)
    ann, bob = found.avatars
    assert (ann.id, ann.prefix, ann.frame_id, ann.cloud_rate) == ("ann", "avatars.ann.", "ann", 60.0)
    assert [(each.name, each.prefix, each.model) for each in ann.garments] == [
        ("top", "avatars.ann.garments.top.", "tshirt"),
        ("legs", "avatars.ann.garments.legs.", "trousers"),
    ]
    assert [each.fit for avatar in (ann, bob) for each in avatar.garments] == [None, None, 0.0, None]
    assert bob.frame_id == "torso" and found.load_timeout == 60.0


def test_garments_are_in_order(tmp_path):
    """That of the file; several models without avatars have names, which do not bear the fabric."""
    pytest.importorskip("yaml")
    text = "avatars: {ann: {garments: {z: {model: tshirt, tucked: true}, a: {model: trousers}}}}"
    (ann,) = load_config(write(tmp_path, f"drape_node: {{ros__parameters: {{{text}}}}}")).avatars
    assert [(each.name, each.tucked) for each in ann.garments] == [("z", True), ("a", False)]
    (avatar,) = read_settings({"model": "trousers:denim, a/my-vest.safetensors:bend=1e-4,b/my_vest", "fit": 0}).avatars
    assert [(each.model, each.name, each.fit) for each in avatar.garments] == [
        ("trousers:denim", "trousers", 0.0),
        ("a/my-vest.safetensors:bend=1e-4", "my_vest", 0.0),
        ("b/my_vest", "my_vest_3", 0.0),
    ]


def test_frames_may_bear_a_slash():
    """In parameters as in messages."""
    (avatar,) = read_settings({"frame_id": "/base", "world_frame": "/map"}).avatars
    assert (avatar.frame_id, avatar.world_frame) == ("base", "map")


ALONE = {  # parameters -> what is said of them
    "modell: tshirt": "unknown key 'modell'; did you mean 'model'",
    "joint_states: /me": "parameter joint_states: joint_states is a topic; to rename it: --ros-args -r joint_states:=",
    "model: ": "model is None; allowed: a string",
    "model: 'a,,b'": "model is 'a,,b'; allowed: models joined by commas",
    "model: 'a,b', tucked: true": "tucked is for one of several garments",
    "tucked: true": "tucked is true; allowed in an outfit of several garments",
    "model: 'a,b', splats: a.ply": "splats is 'a.ply'; splats lie on a garment that is worn alone, not on one of 2",
    "orientation: sun": "orientation is 'sun'; allowed: gravity, odometry, tf, imu",
    "load_timeout: 0.5": "load_timeout is 0.5; allowed: a number from 1 to 3600",
    "fit: 1.5": "fit is 1.5; allowed: a number from 0 to 1",
    "fit: tight": "fit is 'tight'; allowed: a number from 0 to 1",
    "autostart: 1": "autostart is 1; allowed: true or false",
    "max_bodies: 2.5": "max_bodies is 2.5; allowed: a whole number from 1",
    "asset_roots: /tmp": "asset_roots is '/tmp'; allowed: a list of strings",
    "gravity: [0.0, 0.0, 0.0]": "gravity is [0.0, 0.0, 0.0]; allowed: three finite numbers, not all zero",
    "wind: [9.0, 9.0, 9.0]": "wind is [9.0, 9.0, 9.0]; allowed: three finite",
    "wind: 3.0": "wind is 3.0; allowed: three finite numbers",
    "discover: ros4hri": "parameter discover is for avatars",
    "model: a, avatars: {ann: {garments: {top: {model: a}}}}": (
        "parameter model: beside avatars it is given to each of them, as avatars.ID.garments.NAME.model"
    ),
}
AVATARS = {
    "ann: tall": "avatars.ann is 'tall'; expected avatars.ID.KEY",
    "ann: {frame_id: a}": "avatars.ann has no garments; give it one: avatars.ann.garments.NAME.model",
    "ann: {imu: /x, garments: {top: {model: a}}}": "avatars.ann.imu: imu is a topic; to rename it",
    "ann: {garments: {top: {modl: a}}}": "avatars.ann.garments.top.modl: unknown key 'modl'; did you mean 'model'",
    "ann: {}": "avatars.ann is empty; leave it out",
    "ann: {garments: {top: tshirt}}": "expected avatars.ID.KEY or avatars.ID.garments.NAME.KEY, with",
    "7: {garments: {top: {model: a}}}": "'7'; allowed: letters",
    "ann: {garments: {a-b: {model: a}}}": "'a-b'; allowed: letters",
    "ann: {garments: {top: {model: ''}}}": "garments.top.model must not be empty",
    "ann: {cloud_rate: -1, garments: {a: {model: a}}}": "avatars.ann.cloud_rate is -1; allowed: a number from 0",
    "ann: {garments: {a: {tucked: true}}}": "garments.a.tucked is true; allowed in an outfit",
    "ann: {garments: {a: {splats: a.ply}, b: {fit: 0}}}": "avatars.ann.garments.a.splats is 'a.ply'; splats lie on a",
}
FILES = {
    "[": "expected the node content",
    "camera: {ros__parameters: {}}": "names 'camera'; expected drape_node",
    "drape_node: {model: tshirt}": "expected drape_node: {ros__parameters",
    "drape_node: " + "{a: " * 3000 + "1" + "}" * 3000: "is nested too deeply",
    "drape_node: {ros__parameters: {? [1, 2] : 3}}": "found unhashable key",
    "drape_node: {ros__parameters: {" + "k" * 900 + ": 3}}": "parameter kkkk",
    "[" + "1, " * 9000 + "1]": "expected a ROS 2 parameter file",
    "#" * (1 << 20) + "\n": "has 1048577 bytes",
}
FILES |= {f"drape_node: {{ros__parameters: {{{text}}}}}": reason for text, reason in ALONE.items()}
FILES |= {f"drape_node: {{ros__parameters: {{avatars: {{{text}}}}}}}": reason for text, reason in AVATARS.items()}


@pytest.mark.parametrize(("text", "reason"), FILES.items(), ids=[text[-40:] for text in FILES])
def test_what_is_wrong_is_named(tmp_path, text, reason):
    """File, key, value and what is allowed, in a sentence."""
    pytest.importorskip("yaml")
    path = write(tmp_path, text)
    with pytest.raises(SettingsError) as error:
        load_config(path)
    assert reason in str(error.value) and "avatars.yaml" in str(error.value)
    assert len(str(error.value)) <= 300 + 100 * ("allowed in" in str(error.value)), "all keys may be named"


@pytest.mark.slow
def test_a_thousand_damages(tmp_path):
    """Each file is read, or refused in one sentence."""
    pytest.importorskip("yaml")
    shipped = Path(physkin_ros.__file__).parent / "config" / "avatars.yaml"
    path = write(tmp_path, shipped.read_text())
    assert check_refusals(load_config, path, SettingsError, range(1000)) > 300
