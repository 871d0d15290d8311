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
    deadline: 1
    avatars:
      ann: {cloud_rate: 60, gravity: [0, 1, 0], garments: {top: {model: tshirt}, legs: {model: trousers}}}
      bob: {frame_id: torso, garments: {top: {publish_marker: true, fit: 0}, legs: {fit: ""}}}
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
    assert bob.frame_id == "torso" and bob.garments[0].publish_marker and found.deadline == 1.0


def test_garments_are_in_order(tmp_path):
    """That of the file, or of `layers`; several models without avatars have topics of their names."""
    pytest.importorskip("yaml")
    text = """
drape_node: {ros__parameters: {avatars: {
  ann: {garments: {z: {model: tshirt, tucked: true}, a: {model: trousers}}},
  bob: {layers: [b, c, a], outfit: false, garments: {a: {precision: fp32}, b: {fit: 0}, c: {model: skirt}}}}}}
"""
    ann, bob = load_config(write(tmp_path, text)).avatars
    assert [(each.name, each.tucked) for each in ann.garments] == [("z", True), ("a", False)]
    assert (ann.outfit, ann.hide_covered) == (True, True) and not bob.outfit
    assert [each.name for each in bob.garments] == ["b", "c", "a"]
    (avatar,) = load_config(
        write(tmp_path, "drape_node: {ros__parameters: {model: 'trousers, a/my-vest.safetensors,b/my_vest', fit: 0}}")
    ).avatars
    assert [(each.model, each.name, each.namespace, each.fit) for each in avatar.garments] == [
        ("trousers", "trousers", "~/trousers", 0.0),
        ("a/my-vest.safetensors", "my_vest", "~/my_vest", 0.0),
        ("b/my_vest", "my_vest_3", "~/my_vest_3", 0.0),
    ]


def test_topics_do_not_bear_the_fabric():
    (avatar,) = read_settings({"model": "trousers:denim,tshirt,a/skirt.safetensors:bend=1e-4+density=0.18"}).avatars
    assert [each.namespace for each in avatar.garments] == ["~/trousers", "~/tshirt", "~/skirt"]
    assert [each.model for each in avatar.garments][::2] == [
        "trousers:denim",
        "a/skirt.safetensors:bend=1e-4+density=0.18",
    ]


def test_frames_may_bear_a_slash():
    """In parameters as in messages."""
    (avatar,) = read_settings({"frame_id": "/base", "world_frame": "/map"}).avatars
    assert (avatar.frame_id, avatar.world_frame) == ("base", "map")


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("[", "expected the node content"),
        ("camera: {ros__parameters: {}}", "names 'camera'; expected drape_node"),
        ("drape_node: {model: tshirt}", "expected drape_node: {ros__parameters"),
        ("drape_node: {ros__parameters: {modell: tshirt}}", "unknown key 'modell'; did you mean 'model'"),
        (
            "drape_node: {ros__parameters: {model: a, avatars: {ann: {garments: {top: {model: a}}}}}}",
            "parameter model: beside avatars it is given to each of them, as avatars.ID.garments.NAME.model",
        ),
        ("drape_node: {ros__parameters: {model: }}", "model has no value"),
        ("drape_node: {ros__parameters: {executor: many}}", "executor is 'many'; allowed: events, single"),
        ("drape_node: {ros__parameters: {deadline: 100}}", "deadline is 100; allowed: a number from 0 to 60"),
        ("drape_node: {ros__parameters: {fit: 1.5}}", "fit is 1.5; allowed: a number from 0 to 1"),
        ("drape_node: {ros__parameters: {fit: tight}}", "fit is 'tight'; allowed: a number from 0 to 1"),
        ("drape_node: {ros__parameters: {autostart: 1}}", "autostart is 1; allowed: true or false"),
        ("drape_node: {ros__parameters: {max_bodies: 2.5}}", "max_bodies is 2.5; allowed: a whole number from 1"),
        ("drape_node: {ros__parameters: {asset_roots: /tmp}}", "asset_roots is '/tmp'; allowed: a list of strings"),
        ("drape_node: {ros__parameters: {gravity: [0.0, 0, -1]}}", "items of a list must be of one type"),
        ("drape_node: {ros__parameters: {gravity: [0.0, 0.0, 0.0]}}", "three finite numbers"),
        ("drape_node: {ros__parameters: {wind: [9.0, 9.0, 9.0]}}", "wind is [9.0, 9.0, 9.0]; allowed: three finite"),
        ("drape_node: {ros__parameters: {wind: 3.0}}", "wind is 3.0; allowed: three finite numbers"),
        ("drape_node: {ros__parameters: {discover: ros4hri}}", "parameter discover is for avatars"),
        ("{avatars: {ann: tall}}", "avatars.ann is 'tall'; expected avatars.ID.KEY"),
        (
            "{avatars: {ann: {frame_id: a}}}",
            "avatars.ann has no garments; give it one: avatars.ann.garments.NAME.model",
        ),
        (
            "{avatars: {ann: {garments: {top: {modl: a}}}}}",
            "avatars.ann.garments.top.modl: unknown key 'modl'; did you mean 'model'",
        ),
        ("{avatars: {ann: {garments: {top: tshirt}}}}", "expected avatars.ann.garments.NAME.KEY"),
        ("{avatars: {7: {garments: {top: {model: a}}}}}", "is a int; write it in quotes"),
        ("{avatars: {ann: {garments: {a-b: {model: a}}}}}", "garment name 'a-b'; allowed: letters"),
        ("{avatars: {ann: {garments: {top: {model: ''}}}}}", "garments.top.model must not be empty"),
        (
            "{avatars: {ann: {orientation: sun, garments: {top: {model: a}}}}}",
            "orientation is 'sun'; allowed: gravity, pose",
        ),
        (
            "{avatars: {ann: {joint_states: 'a b', garments: {top: {model: a}}}}}",
            "joint_states is 'a b'; allowed: a ROS name",
        ),
        (
            "{avatars: {ann: {effective_gravity_topic: a b, garments: {top: {model: a}}}}}",
            "effective_gravity_topic is 'a b'; allowed: a ROS name",
        ),
        ("drape_node: {ros__parameters: {model: 'a,,b'}}", "model is 'a,,b'; allowed: models joined by commas"),
        ("drape_node: {ros__parameters: {model: 'a,b', tucked: true}}", "tucked is for one of several garments"),
        ("drape_node: {ros__parameters: {tucked: true}}", "tucked is true; allowed in an outfit of several garments"),
        (
            "drape_node: {ros__parameters: {model: 'a,b', splats: a.ply, outfit: false}}",
            "splats is 'a.ply' and model names 2 garments; splats lie on one: avatars.ID.garments.NAME.splats",
        ),
        ("drape_node: {ros__parameters: {model: 'a,b', layers: [b, a]}}", "layers is only for avatars"),
        ("{avatars: {ann: {garments: {a: {tucked: true}}}}}", "garments.a.tucked is true; allowed in an outfit"),
        (
            "{avatars: {ann: {layers: [a, c], garments: {a: {fit: 0}, b: {fit: 0}}}}}",
            "avatars.ann.layers is ['a', 'c']; allowed: a, b, each once",
        ),
        (
            "{avatars: {ann: {garments: {a: {precision: int8}, b: {model: skirt}}}}}",
            "garments.b.precision is '' and avatars.ann.garments.a.precision 'int8'; the garments of an outfit share",
        ),
        (
            "{avatars: {ann: {publish_tf: true, orientation: tf, garments: {a: {model: dress}}}}}",
            "avatars.ann.publish_tf is true and avatars.ann.orientation 'tf'; allowed with pose or odometry",
        ),
        (
            "{avatars: {ann: {imu_delay: -1, garments: {a: {model: dress}}}}}",
            "imu_delay is -1; allowed: a number",
        ),
        (
            "{avatars: {ann: {garments: {a: {splats: a.ply}, b: {model: skirt}}}}}",
            "avatars.ann.garments.a.splats: splats follow one garment, not the layers of an outfit; allowed with",
        ),
        ("{avatars: {ann: {orientation_joints: [a], garments: {top: {model: a}}}}}", "allowed: two names"),
        (
            "{avatars: {ann: {garments: {a: {namespace: /x}, b: {namespace: /x}}}}}",
            "namespace '/x' is given to two garments",
        ),
    ],
)
def test_what_is_wrong_is_named(tmp_path, text, reason):
    """File, key, value and what is allowed."""
    pytest.importorskip("yaml")
    if text.startswith("{avatars"):
        text = f"drape_node: {{ros__parameters: {text}}}"
    path = write(tmp_path, text)
    with pytest.raises(SettingsError) as error:
        load_config(path)
    assert reason in str(error.value) and str(path) in str(error.value)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("drape_node: " + "{a: " * 3000 + "1" + "}" * 3000, "it is nested more than 20 deep"),
        ("a: &a [1, 2]\ndrape_node: {ros__parameters: {model: *a}}", "has an alias (*NAME)"),
        ("drape_node: {ros__parameters: {? [1, 2] : 3}}", "found unhashable key"),
        ("drape_node: {ros__parameters: {" + "k" * 900 + ": 3}}", "parameter kkkk"),
        ("[" + "1, " * 9000 + "1]", "expected a ROS 2 parameter file"),
        ("#" * (1 << 20) + "\n", "has 1048577 bytes"),
    ],
)
def test_files_that_hurt_are_refused_in_a_sentence(tmp_path, text, reason):
    """Nested, expanding, long: whatever the parser trips over."""
    pytest.importorskip("yaml")
    path = write(tmp_path, text)
    with pytest.raises(SettingsError) as error:
        load_config(path)
    assert reason in str(error.value) and "avatars.yaml" in str(error.value) and len(str(error.value)) <= 300


@pytest.mark.slow
def test_a_thousand_damages(tmp_path):
    """Each file is read, or refused in one sentence."""
    pytest.importorskip("yaml")
    shipped = Path(physkin_ros.__file__).parent / "config" / "avatars.yaml"
    path = write(tmp_path, shipped.read_text())
    assert check_refusals(load_config, path, SettingsError, range(1000)) > 300
