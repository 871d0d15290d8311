"""Replay of bags: clip to bag to clouds, and messages that are not what they should be."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict

import numpy as np
import pytest

pytest.importorskip("rosbags", reason="needs rosbags: pip install 'physkin[replay]'")

from bag_messages import gravity, joint_state, recorded  # noqa: E402

from physkin_core import BUNDLED_AVATAR, Draper, LimbSeparator, cli, load_garment_model  # noqa: E402
from physkin_core.motion.bag_reader import GRAVITY, JOINT_STATE, TYPES, BagReader  # noqa: E402
from physkin_core.quality import area_strain, edge_strain, jitter, signed_distance  # noqa: E402
from physkin_core.runtime.bound_garment import plain_skinning  # noqa: E402
from physkin_ros.messages.conversions import read_cloud  # noqa: E402
from physkin_ros.replay.bags import BagWriter, write_motion  # noqa: E402
from physkin_ros.replay.figures import describe, summary  # noqa: E402
from physkin_ros.replay.replay import GARMENT_TOPIC, replay  # noqa: E402


def expected_clouds(draper, motion):
    positions = motion.positions_for(draper.model.rig)
    return [draper.drape(q, gravity) for q, gravity in zip(positions, motion.gravity)]


@pytest.mark.parametrize("suffix", ["", ".db3", ".mcap"])
def test_clip_to_bag_to_clouds(suffix, draper, motion, tmp_path):
    """The output bag holds the draper's clouds, bit by bit, at the times and with the stamps of the joint states."""
    bag, output = tmp_path / f"in{suffix}", tmp_path / f"out{suffix}"
    with BagWriter(bag) as writer:
        write_motion(writer, motion, frame_id="torso")
    with BagReader(bag) as source, BagWriter(output) as writer:
        replay(draper, source, writer)
    assert output.is_file() == bool(suffix)
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([bag.name, output.name])
    sent = [entry for entry in recorded(bag) if entry[0] == "/joint_states"]
    clouds = recorded(output)
    assert [entry[0] for entry in clouds] == [GARMENT_TOPIC] * 12
    assert [entry[1] for entry in clouds] == [entry[1] for entry in sent]
    for (_, _, state), (_, _, cloud), expected in zip(sent, clouds, expected_clouds(draper, motion)):
        assert cloud.header.stamp == state.header.stamp and cloud.header.frame_id == "base_link" and cloud.is_dense
        np.testing.assert_array_equal(read_cloud(cloud), expected)


def test_clouds_hang_in_the_world(draper, motion, tmp_path):
    """Transforms of the bag go along, bit by bit, and are no part of what is measured or compared."""
    with BagWriter(tmp_path / "bare") as writer:
        write_motion(writer, motion, frame_id="base_link")
    with BagWriter(tmp_path / "in") as writer:
        write_motion(writer, motion, frame_id="base_link", world_frame="world")
    found = []
    for name in ("bare", "in"):
        with BagReader(tmp_path / name, root=["transforms"]) as source, BagWriter(tmp_path / f"{name}_out") as writer:
            found.append(replay(draper, source, writer))
    assert found[0].bag_sha256 == found[1].bag_sha256 and found[0].clouds_sha256 == found[1].clouds_sha256
    sent, came = ([e for e in recorded(tmp_path / name) if e[0] == "/tf"] for name in ("in", "in_out"))
    assert len(came) == motion.frame_count and str(came) == str(sent)
    assert {topic for topic, *_ in recorded(tmp_path / "bare_out")} == {GARMENT_TOPIC}


def test_figures_are_those_of_the_core(draper, motion, figures):
    """Strain, contact and jitter of the very clouds, over all of them."""
    clouds = np.stack([cloud[:, :3] for cloud in expected_clouds(draper, motion)]).astype(np.float64)
    bones = [draper.bone_transforms(q) for q in motion.positions_for(draper.model.rig)]
    skinned = np.stack([plain_skinning(draper.bound, each) for each in bones])
    shown, garment = figures["figures"], draper.rest_garment
    assert shown["edge_strain_percent"]["mean"] == pytest.approx(edge_strain(garment, clouds).mean())
    assert shown["area_strain_percent"]["max"] == pytest.approx(area_strain(garment, clouds).max())
    assert shown["jitter_mm"]["mean"] == pytest.approx(1000 * jitter(clouds))
    assert shown["jitter_ratio"]["mean"] == pytest.approx(jitter(clouds) / jitter(skinned))
    avatar = draper.avatar
    distances = [signed_distance(clouds[k], avatar.posed_vertices(bones[k]), avatar.faces) for k in (0, 4, 8)]
    assert shown["inside_percent"]["mean"] == pytest.approx(100 * np.mean([d < 0 for d in distances]))
    assert shown["max_depth_mm"]["max"] == pytest.approx(-1000 * np.min(distances), abs=1e-4)
    assert figures["bag"]["rate_hz"] == pytest.approx(60, rel=1e-6)
    assert figures["counts"]["jitter_clouds"] == 10 and figures["counts"]["contact_clouds"] == 3


def test_a_sway_network_moves_cloth_by_the_stamps(swaying_model_path, avatar, bag, motion):
    """As that of a draper that is told the same times; twice the same, and otherwise than each pose by itself."""
    draper, told = (Draper(load_garment_model(swaying_model_path), avatar) for _ in range(2))
    found, clouds, swung = [], hashlib.sha256(), 0.0
    for _ in range(2):
        with BagReader(bag) as source:
            found.append(replay(draper, source).clouds_sha256)
    stamps = [message.header.stamp for topic, _, message in recorded(bag) if topic == "/joint_states"]
    for q, down, stamp in zip(motion.positions_for(told.model.rig), motion.gravity, stamps):
        cloud = told.drape(q, down, time=1e-9 * (stamp.sec * 10**9 + stamp.nanosec))
        clouds.update(cloud.tobytes())
        swung = max(swung, np.abs(cloud - draper.drape(q, down))[:, :3].max())
    assert found == [clouds.hexdigest()] * 2 and swung > 0.005


def test_strain_is_against_the_rest_shape_that_is_worn(model_path, avatar, bag, motion):
    """Made to measure by default, and told so."""
    draper = Draper(load_garment_model(model_path), avatar)
    with BagReader(bag) as source:
        figures = describe(replay(draper, source), draper, source, contact_every=0)
    clouds = np.stack([cloud[:, :3] for cloud in expected_clouds(draper, motion)]).astype(np.float64)
    worn, template = (edge_strain(garment, clouds).mean() for garment in (draper.rest_garment, draper.model.garment))
    assert figures["figures"]["edge_strain_percent"]["mean"] == pytest.approx(worn) != pytest.approx(template)
    assert figures["run"]["fit"] == 1.0 and "fit 1, on" in summary(figures)
    assert figures["run"]["at_rest"] == asdict(draper.at_rest)


def test_limbs_are_separated_when_told_to(quick, leaning_model_path, draper, avatar, tmp_path):
    """Clouds are of the separated positions, and measured against the body that these pose."""
    rig = draper.model.rig
    folded = rig.joint_positions({"upperleg01.L_x": -0.2, "upperleg01.R_x": 0.2})
    bag, output, figures = tmp_path / "in.mcap", tmp_path / "out.mcap", tmp_path / "out.json"
    with BagWriter(bag) as writer:
        writer.write("/joint_states", JOINT_STATE, joint_state(rig.joint_names, folded), 1)
    told = ["replay", str(bag), "-g", str(leaning_model_path), "-o", str(output), "--json", str(figures)]
    assert cli.main([*told, "--separate-limbs"]) == 0
    separated, change = LimbSeparator(rig, avatar).separate(folded)
    expected = draper.drape(separated)
    assert change > 0.01
    [(_, _, cloud)] = recorded(output)
    np.testing.assert_array_equal(read_cloud(cloud), expected)
    body = avatar.posed_vertices(draper.bone_transforms(separated))
    inside = 100 * (signed_distance(expected[:, :3].astype(np.float64), body, avatar.faces) < 0).mean()
    assert json.loads(figures.read_text())["figures"]["inside_percent"]["mean"] == pytest.approx(inside, abs=1e-3)


def test_gravity_counts_from_when_it_comes(run, draper, tmp_path):
    """Of a moment's messages first; upright before any; a direction that is none changes nothing."""
    names, rest = draper.joint_names, draper.model.rig.rest
    path = tmp_path / "lean.db3"
    with BagWriter(path) as writer:
        writer.write("/joint_states", JOINT_STATE, joint_state(names, rest), 1)
        writer.write("/joint_states", JOINT_STATE, joint_state(names, rest), 2)
        writer.write("/gravity", GRAVITY, gravity(9.81, 0, 0), 2)
        for bad in ((0, 0, 0), (np.nan, 0, 1), (1e200, 1e200, 0)):
            writer.write("/gravity", GRAVITY, gravity(*bad), 3)
        writer.write_bytes("/gravity", GRAVITY, b"\0\1\0\0\0", 3)
        writer.write("/joint_states", JOINT_STATE, joint_state(names, rest), 4)
    found, figures = run(path)
    np.testing.assert_allclose(np.array(found.down), [[0, 0, -1], [1, 0, 0], [1, 0, 0]])
    assert figures["counts"]["gravity_messages"] == 5 and figures["counts"]["gravity_rejected"] == 4
    assert np.ptp(found.measured["edge_strain_percent"]) > 0


def test_bad_messages_are_counted_and_skipped(draper, tmp_path):
    """The clouds are those of the good ones, on top of the last good state. A joint that is not finite stays, and a
    joint state without positions is no trouble."""
    first, second = draper.joint_names[:2]
    huge = bytes(TYPES.serialize_cdr(joint_state([first], [0.0]), JOINT_STATE)[:20]) + b"\xff\xff\xff\x7f" * 3
    good = [joint_state([first], [0.1]), joint_state([first, second, "tail"], [np.nan, 0.2, np.nan])]
    bad = {
        "names no joints": joint_state([], []),
        f"'{second}' is inf": joint_state([second], [np.inf]),
        "no joint is known": joint_state(["tail"], [0.3]),
    }
    path, output = tmp_path / "bad.mcap", tmp_path / "out.mcap"
    with BagWriter(path) as writer:
        writer.write("/joint_states", JOINT_STATE, good[0], 1_000)
        for time_ns, message in enumerate(bad.values(), start=1_001):
            writer.write("/joint_states", JOINT_STATE, message, time_ns)
        for time_ns, data in enumerate((b"", b"\0", b"\0\1\0\0", huge, b"\xff" * 64), start=1_100):
            writer.write_bytes("/joint_states", JOINT_STATE, data, time_ns)
        writer.write("/joint_states", JOINT_STATE, joint_state([first], []), 1_200)
        writer.write("/joint_states", JOINT_STATE, good[1], 2_000)
    with BagReader(path) as bag, BagWriter(output) as writer:
        found = replay(draper, bag, writer)
        figures = describe(found, draper, bag, contact_every=0)
    counts = figures["counts"]
    assert (counts["joint_states"], counts["draped"], counts["rejected"]) == (11, 2, 8)
    assert (counts["not_finite"], counts["without_positions"]) == (1, 1)
    assert "positions not finite / missing  1 / 1" in summary(figures)
    for reason in bad:
        assert [count for text, count in figures["reasons"].items() if reason in text] == [1], reason
    assert sum(count for text, count in figures["reasons"].items() if "bytes that are no joint state" in text) == 5
    assert figures["counts"]["names_unknown"] == 1
    clouds = [(time_ns, read_cloud(message)) for _, time_ns, message in recorded(output)]
    assert [time_ns for time_ns, _ in clouds] == [1_000, 2_000]
    np.testing.assert_array_equal(clouds[0][1], draper.drape({first: 0.1}))
    np.testing.assert_array_equal(clouds[1][1], draper.drape({first: 0.1, second: 0.2}))


def test_joint_maps_are_the_nodes(run, draper, tmp_path):
    """A map file and ros4hri, as the node takes them."""
    joint, bent = draper.joint_names[0], draper.joint_names.index("lowerarm01.L_z")
    (tmp_path / "map.json").write_text(json.dumps({"mine": {"joint": joint, "scale": -2.0, "offset": 0.1}}))
    positions = []
    for name, value, joint_map in (("mine", 0.2, tmp_path / "map.json"), ("l_elbow_ab12c", 0.0, "ros4hri")):
        with BagWriter(tmp_path / name) as writer:
            writer.write("/humans/bodies/ab12c/joint_states", JOINT_STATE, joint_state([name], [value]), 1)
        positions.append(run(tmp_path / name, joint_map=joint_map)[0].positions[0])
    assert positions[0][0] == pytest.approx(-0.3) and positions[1][bent] != draper.model.rig.rest[bent]


def test_jitter_is_not_measured_over_gaps(run, motion, tmp_path):
    """A pause in the recording is no jump of the cloth."""
    path = tmp_path / "gap.mcap"
    with BagWriter(path) as writer:
        for k, positions in enumerate(motion.positions):
            time_ns = 1_000 + 10 * k + (1_000 if k >= 6 else 0)
            writer.write("/joint_states", JOINT_STATE, joint_state(motion.joint_names, positions), time_ns)
    _, figures = run(path)
    missing = [k for k, value in enumerate(figures["series"]["jitter_mm"]) if value is None]
    assert missing == [0, 1, 6, 7] and figures["counts"]["jitter_clouds"] == 8


def test_joints_beyond_their_limits_are_named(run, draper, tmp_path):
    """The networks have not seen such poses."""
    joint, rig = draper.joint_names[3], draper.model.rig
    with BagWriter(tmp_path / "far.mcap") as writer:
        for k, value in enumerate((rig.upper[3], rig.upper[3] + 0.1, rig.lower[3] - 0.1)):
            writer.write("/joint_states", JOINT_STATE, joint_state([joint], [value]), k)
    _, figures = run(tmp_path / "far.mcap")
    assert figures["out_of_range"] == {joint: 2} and figures["counts"]["out_of_range_clouds"] == 2


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["replay", "{tmp}/none"], "no such file"),
        (["replay", "{bag}", "--topic", "/clouds"], "topic /clouds is not in it; topics of sensor_msgs/msg/JointState"),
        (["replay", "{bag}", "--topic", "/gravity"], "topic /gravity is geometry_msgs/msg/Vector3Stamped"),
        (["replay", "{bag}", "--orientation-topic", "/up"], "topic /up is not in it"),
        (
            ["replay", "{bag}", "--joint-map", "mixamo"],
            "mixamo: no such file; allowed: a JSON file, ros4hri, vrm",
        ),
        (["replay", "{bag}", "--baseline", "{tmp}/none.json"], "none.json: no such file"),
        (["replay", "{bag}", "-g", "skirt"], "replay drapes one garment, got 2: skirt, "),
        (["replay", "{tmp}/text.mcap"], "bag "),
        (["replay", "{tmp}/text.db3"], "bag "),
        (["replay", "{tmp}/strange.mcap", "-o", "{tmp}/out"], "none of the 1 joint states on /joint_states"),
        (["convert", "nosuch", "{tmp}/a.mcap"], "no bundled motion 'nosuch'"),
    ],
)
def test_errors_are_one_line(quick, arguments, reason, bag, model_path, tmp_path, capsys):
    """Exit status 2, a sentence on stderr, after how the garment sits if it was bound, and nothing left behind."""
    for suffix in (".mcap", ".db3"):
        (tmp_path / f"text{suffix}").write_text("this is no bag" * 100)
    with BagWriter(tmp_path / "strange.mcap") as writer:
        writer.write("/joint_states", JOINT_STATE, joint_state(["tail"], [0.0]), 1)
    before = sorted(tmp_path.iterdir())
    filled = [word.format(bag=bag, tmp=tmp_path) for word in arguments]
    model = ["-g", str(model_path)] if filled[0] == "replay" else []
    assert cli.main([*filled, *model]) == 2
    *warnings, line = capsys.readouterr().err.splitlines()
    assert line.startswith("error: ") and reason in line
    assert [warning.split(":")[:2] for warning in warnings] in ([], [["warning", f" vest on {BUNDLED_AVATAR}"]])
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.parametrize("words", ["--json no/a.json", "--report no/a.html"])
def test_wrong_arguments_are_told_before_anything_is_read(words, capsys):
    """By their value."""
    with pytest.raises(SystemExit):
        cli.main(["replay", "nosuch.mcap", *words.split()])
    assert words.split()[-1] in capsys.readouterr().err
