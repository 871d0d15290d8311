"""Replay of bags: clip to bag to clouds, messages that are not what they should be, baselines, and the page."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("rosbags", reason="needs rosbags: pip install 'physkin[replay]'")

from rosbags.interfaces import QosReliability  # noqa: E402
from rosbags.rosbag2 import Reader  # noqa: E402
from scipy.spatial.transform import Rotation  # noqa: E402

from physkin_core import (  # noqa: E402
    BUNDLED_AVATAR,
    Draper,
    Motion,
    cli,
    load_avatar,
    load_garment_model,
    load_motion,
    save_garment_model,  # noqa: E402
)
from physkin_core.model.garment import vertex_normals  # noqa: E402
from physkin_core.model.skinning import plain_skinning  # noqa: E402
from physkin_core.quality import area_strain, edge_strain, jitter, signed_distance  # noqa: E402
from physkin_ros.messages.conversions import read_cloud  # noqa: E402
from physkin_ros.replay.bags import GRAVITY, JOINT_STATE, TYPES, BagError, BagReader, BagWriter, write_motion  # noqa: E402
from physkin_ros.replay.figures import TOLERANCES, BaselineError, describe, load_baseline, regressions, summary  # noqa: E402
from physkin_ros.replay.replay import replay  # noqa: E402
from physkin_ros.replay.report import thumbnails, write_report  # noqa: E402

CLOUDS = "/drape_node/garment"
TIME, HEADER, VECTOR3 = (
    TYPES.types[name] for name in ("builtin_interfaces/msg/Time", "std_msgs/msg/Header", "geometry_msgs/msg/Vector3")
)


@pytest.fixture(scope="module")
def avatar(leaning_model):
    """Read once: it takes seconds."""
    return load_avatar(BUNDLED_AVATAR, leaning_model.rig)


@pytest.fixture
def quick(avatar, monkeypatch):
    """For the command line: the avatar that was read already."""
    monkeypatch.setattr("physkin_ros.replay.replay.load_avatar", lambda *arguments, **settings: avatar)


@pytest.fixture(scope="module")
def draper(leaning_model_path, avatar):
    """Of a garment that heeds gravity; from the file, which rounds."""
    return Draper(load_garment_model(leaning_model_path), avatar)


@pytest.fixture(scope="module")
def crumpled_path(leaning_model, tmp_path_factory):
    """A model of the same garment that strains it far more."""
    *layers, (weight, bias) = leaning_model.node_deformer
    crumpled = dataclasses.replace(leaning_model, node_deformer=(*layers, (30 * weight, 30 * bias)))
    path = tmp_path_factory.mktemp("models") / "crumpled.safetensors"
    save_garment_model(crumpled, path)
    return path


@pytest.fixture(scope="module")
def motion():
    """A few frames of a body that leans."""
    clip = load_motion("crawl")
    fields = ("positions", "root_orientation", "root_position")
    return Motion(clip.joint_names, *(getattr(clip, name)[:12] for name in fields), clip.rate_hz, "crawl")


@pytest.fixture(scope="module")
def bag(motion, tmp_path_factory):
    """The clip as a bag."""
    return save(motion, tmp_path_factory.mktemp("bags") / "crawl.mcap")


@pytest.fixture(scope="module")
def figures(draper, bag):
    """Figures of the clip, contact on every fourth cloud."""
    return run(draper, bag, contact_every=4)[1]


def save(motion, path):
    with BagWriter(path) as writer:
        write_motion(writer, motion, frame_id="torso")
    return path


def run(draper, path, *, contact_every=0, **settings):
    """Replay and figures."""
    with BagReader(path) as bag:
        found = replay(draper, bag, contact_every=contact_every, **settings)
        return found, describe(found, draper, bag, contact_every=contact_every)


def expected_clouds(draper, motion):
    positions = motion.positions_for(draper.model.rig)
    return [draper.drape(q, gravity) for q, gravity in zip(positions, motion.gravity)]


def recorded(path):
    """Topic, time [ns] and message of everything in a bag."""
    with Reader(path) as reader:
        return [
            (connection.topic, time_ns, TYPES.deserialize_cdr(data, connection.msgtype))
            for connection, time_ns, data in reader.messages()
        ]


def joint_state(names, positions, seconds=1):
    nothing, header = np.zeros(0), HEADER(TIME(seconds, 0), "torso")
    return TYPES.types[JOINT_STATE](header, list(names), np.array(positions, dtype=np.float64), nothing, nothing)


def gravity(x, y, z):
    return TYPES.types[GRAVITY](HEADER(TIME(0, 0), ""), VECTOR3(float(x), float(y), float(z)))


@pytest.mark.parametrize("storage", ["sqlite3", "mcap"])
@pytest.mark.parametrize("single", [True, False])
def test_clip_to_bag_to_clouds(storage, single, draper, motion, tmp_path):
    """The output bag holds the draper's clouds, bit by bit, at the times and with the stamps of the joint states."""
    suffix = {"sqlite3": ".db3", "mcap": ".mcap"}[storage] if single else ""
    bag, output = tmp_path / f"in{suffix}", tmp_path / f"out{suffix}"
    with BagWriter(bag, storage=storage) as writer:
        write_motion(writer, motion, frame_id="torso")
    with BagReader(bag) as source, BagWriter(output, storage=storage) as writer:
        replay(draper, source, writer)
    assert output.is_file() == single
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([bag.name, output.name])
    sent = [entry for entry in recorded(bag) if entry[0] == "/joint_states"]
    clouds = recorded(output)
    assert [entry[0] for entry in clouds] == [CLOUDS] * 12
    assert [entry[1] for entry in clouds] == [entry[1] for entry in sent]
    for (_, _, state), (_, _, cloud), expected in zip(sent, clouds, expected_clouds(draper, motion)):
        assert cloud.header.stamp == state.header.stamp and cloud.header.frame_id == "base_link" and cloud.is_dense
        np.testing.assert_array_equal(read_cloud(cloud), expected)


def test_output_is_playable(draper, bag, tmp_path):
    """What `ros2 bag play` of Jazzy reads: metadata version 9, type, hash, definition and a reliable publisher."""
    with BagReader(bag) as source, BagWriter(tmp_path / "out") as writer:
        replay(draper, source, writer)
    metadata = (tmp_path / "out" / "metadata.yaml").read_text()
    assert re.search(r"^  version: 9$", metadata, re.M) and "storage_identifier: mcap" in metadata
    assert re.search(r"^  message_count: 12$", metadata, re.M) and "reliability: reliable" in metadata
    with Reader(tmp_path / "out") as reader:
        (connection,) = reader.connections
        assert connection.msgtype == "sensor_msgs/msg/PointCloud2" and "uint32 point_step" in connection.msgdef.data
        assert connection.digest == TYPES.hash_rihs01(connection.msgtype)
        assert connection.ext.offered_qos_profiles[0].reliability is QosReliability.RELIABLE


def test_same_bag_same_result(draper, bag, figures):
    """Clouds and figures agree to the last bit; latencies may not."""
    _, again = run(draper, bag, contact_every=4)
    for part in (again["series"], figures["series"]):
        assert len(part["latency_us"]) == 12
    timed = {"latency_us", "series"}
    assert {k: v for k, v in again.items() if k not in timed} == {k: v for k, v in figures.items() if k not in timed}
    assert {k: v for k, v in again["series"].items() if k not in timed} == {
        k: v for k, v in figures["series"].items() if k not in timed
    }


def test_figures_are_those_of_the_core(draper, motion, figures):
    """Strain, contact and jitter of the very clouds, over all of them."""
    clouds = np.stack([cloud[:, :3] for cloud in expected_clouds(draper, motion)]).astype(np.float64)
    bones = [draper.bone_transforms(q) for q in motion.positions_for(draper.model.rig)]
    skinned = np.stack([plain_skinning(draper.bound, each) for each in bones])
    shown, garment = figures["figures"], draper.model.garment
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


def test_gravity_counts_from_when_it_comes(draper, motion, tmp_path):
    """Of a moment's messages first; the parameter before any; a direction that is none changes nothing."""
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
    found, figures = run(draper, path, gravity=np.array([0.0, 1.0, 0.0]))
    np.testing.assert_allclose(np.array(found.gravity), [[0, 1, 0], [9.81, 0, 0], [9.81, 0, 0]])
    assert figures["counts"]["gravity_messages"] == 5 and figures["counts"]["gravity_rejected"] == 4
    assert np.ptp(found.edge_strain) > 0


def test_bad_messages_are_counted_and_skipped(draper, tmp_path):
    """The clouds are those of the good ones, on top of the last good state."""
    first, second = draper.joint_names[:2]
    huge = bytes(TYPES.serialize_cdr(joint_state([first], [0.0]), JOINT_STATE)[:20]) + b"\xff\xff\xff\x7f" * 3
    good = [joint_state([first], [0.1]), joint_state([second, "tail"], [0.2, np.nan])]
    bad = {
        "names no joints": joint_state([], []),
        "2 names but 1 positions": joint_state([first, second], [0.5]),
        f"'{first}' is nan": joint_state([first], [np.nan]),
        f"'{second}' is inf": joint_state([first, second], [0.3, np.inf]),
        "the same joint": joint_state([first, first], [0.3, 0.3]),
        "no joint is known": joint_state(["tail"], [0.3]),
    }
    path, output = tmp_path / "bad.mcap", tmp_path / "out.mcap"
    with BagWriter(path) as writer:
        writer.write("/joint_states", JOINT_STATE, good[0], 1_000)
        for time_ns, message in enumerate(bad.values(), start=1_001):
            writer.write("/joint_states", JOINT_STATE, message, time_ns)
        for time_ns, data in enumerate((b"", b"\0", b"\0\1\0\0", huge, b"\xff" * 64), start=1_100):
            writer.write_bytes("/joint_states", JOINT_STATE, data, time_ns)
        writer.write("/joint_states", JOINT_STATE, good[1], 2_000)
    with BagReader(path) as bag, BagWriter(output) as writer:
        found = replay(draper, bag, writer)
        figures = describe(found, draper, bag, contact_every=0)
    assert found.counts["joint_states"] == 13 and found.counts["draped"] == 2 and found.counts["rejected"] == 11
    for reason in bad:
        assert [count for text, count in figures["reasons"].items() if reason in text] == [1], reason
    assert sum(count for text, count in figures["reasons"].items() if "bytes that are no joint state" in text) == 5
    assert figures["counts"]["names_unknown"] == 1
    clouds = [(time_ns, read_cloud(message)) for _, time_ns, message in recorded(output)]
    assert [time_ns for time_ns, _ in clouds] == [1_000, 2_000]
    np.testing.assert_array_equal(clouds[0][1], draper.drape({first: 0.1}))
    np.testing.assert_array_equal(clouds[1][1], draper.drape({first: 0.1, second: 0.2}))


def test_joint_maps_are_the_nodes(draper, tmp_path):
    """A map file and ros4hri, as the node takes them."""
    joint = draper.joint_names[0]
    map_file = tmp_path / "map.json"
    map_file.write_text(json.dumps({"mine": {"joint": joint, "scale": -2.0, "offset": 0.1}}))
    for name, states, settings in (
        ("mapped", [joint_state(["mine"], [0.2])], {"joint_map": map_file}),
        ("human", [joint_state(["l_elbow_ab12c"], [0.0])], {"joint_map": "ros4hri"}),
    ):
        with BagWriter(tmp_path / name) as writer:
            for state in states:
                writer.write("/humans/bodies/ab12c/joint_states", JOINT_STATE, state, 1)
        found, _ = run(draper, tmp_path / name, **settings)
        if name == "mapped":
            assert found.positions[0][0] == pytest.approx(-0.3)
        else:
            bent = found.positions[0][draper.joint_names.index("lowerarm01.L_z")]
            assert bent != draper.model.rig.rest[draper.joint_names.index("lowerarm01.L_z")]


def test_jitter_is_not_measured_over_gaps(draper, motion, tmp_path):
    """A pause in the recording is no jump of the cloth."""
    path = tmp_path / "gap.mcap"
    with BagWriter(path) as writer:
        for k, positions in enumerate(motion.positions):
            time_ns = 1_000 + 10 * k + (1_000 if k >= 6 else 0)
            writer.write("/joint_states", JOINT_STATE, joint_state(motion.joint_names, positions), time_ns)
    _, figures = run(draper, path)
    missing = [k for k, value in enumerate(figures["series"]["jitter_mm"]) if value is None]
    assert missing == [0, 1, 6, 7] and figures["counts"]["jitter_clouds"] == 8


@pytest.mark.parametrize("count", [1, 3])
def test_little_is_enough_for_a_page(count, draper, tmp_path):
    """One joint state, or several at one moment, upside down: no rate and no jitter, but figures, plots and scenes."""
    path, page, scenes = tmp_path / "one.mcap", tmp_path / "page.html", []
    with BagWriter(path) as writer:
        writer.write("/gravity", GRAVITY, gravity(0, 0, 1), 7)
        for _ in range(count):
            writer.write("/joint_states", JOINT_STATE, joint_state(draper.joint_names, draper.model.rig.rest), 7)
    found, figures = run(draper, path)
    assert figures["counts"]["draped"] == count and figures["figures"]["jitter_mm"]["mean"] is None
    assert figures["bag"]["rate_hz"] is None and figures["figures"]["inside_percent"]["max"] is None
    write_report(page, json.loads(json.dumps(figures, allow_nan=False)))
    assert page.read_text().count("<svg") == 3 and summary(figures)
    with pytest.MonkeyPatch.context() as patch:
        blank = np.zeros((4, 4, 3), dtype=np.uint8)
        patch.setattr("physkin_ros.replay.report.render", lambda meshes, **_: scenes.append(meshes) or blank)
        pytest.importorskip("PIL", reason="needs pillow: pip install 'physkin[view]'")
        thumbnails(found, draper, count=2)
    body = scenes[0][0].vertices
    assert body[body[:, 2].argmax()] @ [0, 0, 1] == pytest.approx(-draper.avatar.vertices[:, 2].min(), abs=1e-3)


def test_joints_beyond_their_limits_are_named(draper, tmp_path):
    """The networks have not seen such poses."""
    joint, rig = draper.joint_names[3], draper.model.rig
    with BagWriter(tmp_path / "far.mcap") as writer:
        for k, value in enumerate((rig.upper[3], rig.upper[3] + 0.1, rig.lower[3] - 0.1)):
            writer.write("/joint_states", JOINT_STATE, joint_state([joint], [value]), k)
    _, figures = run(draper, tmp_path / "far.mcap")
    assert figures["out_of_range"] == {joint: 2} and figures["counts"]["out_of_range_clouds"] == 2


def test_baseline_of_the_same_run_passes(quick, leaning_model_path, bag, tmp_path, capsys):
    """And its report says so."""
    old, page, output = tmp_path / "old.json", tmp_path / "page.html", tmp_path / "out"
    arguments = ["replay", str(bag), "--model", str(leaning_model_path), "--contact-every", "12"]
    assert cli.main([*arguments, "--json", str(old), "-o", str(output)]) == 0
    clouds = np.stack([read_cloud(message) for _, _, message in recorded(output)])
    assert json.loads(old.read_text())["clouds_sha256"] == hashlib.sha256(clouds.tobytes()).hexdigest()
    again = ["--baseline", str(old), "--report", str(page), "--pictures", "0", "--json", str(tmp_path / "new.json")]
    assert cli.main([*arguments, *again]) == 0
    assert "not worse than" in capsys.readouterr().out and "Not worse than the baseline" in page.read_text()


def test_normals_of_faces_when_asked(leaning_model_path, bag, tmp_path):
    arguments = ["replay", str(bag), "--model", str(leaning_model_path), "--contact-every", "0", "--normals", "faces"]
    assert cli.main([*arguments, "-o", str(tmp_path / "out")]) == 0
    model = load_garment_model(leaning_model_path)
    faces = Draper(model, load_avatar(BUNDLED_AVATAR, model.rig), normals="faces").faces
    for _, _, message in recorded(tmp_path / "out")[::20]:
        cloud = read_cloud(message)
        np.testing.assert_allclose(cloud[:, 3:], vertex_normals(cloud[:, :3], faces), atol=1e-3)


def test_worse_garment_fails_against_the_baseline(quick, crumpled_path, leaning_model_path, bag, tmp_path, capsys):
    """Exit status 1, and which figure it is."""
    old, page = tmp_path / "old.json", tmp_path / "page.html"
    arguments = ["replay", str(bag), "--contact-every", "0"]
    assert cli.main([*arguments, "--model", str(leaning_model_path), "--json", str(old)]) == 0
    worse = ["--model", str(crumpled_path), "--baseline", str(old), "--report", str(page), "--pictures", "0"]
    assert cli.main([*arguments, *worse]) == 1
    captured = capsys.readouterr()
    assert "edge_strain_percent mean is" in captured.err and "Worse than the baseline" in page.read_text()


@pytest.mark.parametrize("key", TOLERANCES)
def test_each_figure_may_grow_so_far_and_no_further(key, figures):
    """What the table of tolerances states is what fails."""
    name, kind = key
    share, margin = TOLERANCES[key]
    old = json.loads(json.dumps(figures))
    value = figures["figures"][name][kind]
    assert not regressions(figures, old)
    old["figures"][name][kind] = (value - margin) / (1 + share) + 1e-9
    assert not regressions(figures, old)
    old["figures"][name][kind] -= 1e-6 + 1e-6 * value
    (line,) = regressions(figures, old)
    assert line.startswith(f"{name} {kind} is ")
    figures = json.loads(json.dumps(figures))
    figures["figures"][name][kind] = None
    assert any("is missing" in line for line in regressions(figures, old))


def test_counts_and_latencies_against_the_baseline(figures):
    """One more rejection fails; latencies only when asked."""
    old = json.loads(json.dumps(figures))
    old["latency_us"]["p99"] = figures["latency_us"]["p99"] / 2
    assert not regressions(figures, old)
    assert not regressions(figures, old, latency_percent=101)
    assert regressions(figures, old, latency_percent=50)[0].startswith("latency_us p99 is")
    worse = json.loads(json.dumps(figures))
    worse["counts"]["rejected"] = 1
    assert regressions(worse, figures) == ["rejected is 1; it was 0, allowed is 0"]


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda old: old["bag"].update(sha256="0"), "its bag sha256 is 0"),
        (lambda old: old["run"].update(contact_every=7), "its run contact_every is 7, this one's is 4"),
        (lambda old: old["figures"]["jitter_mm"].update(mean="much"), "figures jitter_mm mean is 'much'|is 'much'"),
    ],
)
def test_baselines_that_do_not_fit_are_refused(change, reason, figures):
    """Another recording says nothing about this one."""
    old = json.loads(json.dumps(figures))
    change(old)
    with pytest.raises(BaselineError, match=reason):
        regressions(figures, old)


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"schema": 2}', '{"schema": 1, "bag": 3}'])
def test_broken_baselines_are_refused(text, tmp_path):
    """Before anything is draped."""
    path = tmp_path / "old.json"
    path.write_text(text)
    with pytest.raises(BaselineError, match="baseline"):
        load_baseline(path)


def test_page_stands_alone_and_escapes(figures, tmp_path):
    """One file that loads nothing; a joint name cannot smuggle anything in."""
    figures = json.loads(json.dumps(figures))
    figures["reasons"] = {"joint '<script>' is nan": 3}
    path = tmp_path / "page.html"
    write_report(path, figures, [("0.10 s", b"\x89PNG")], "a remark", ["edge strain <up>"])
    page = path.read_text()
    assert "<script" not in page and "&lt;script&gt;" in page and "&lt;up&gt;" in page
    assert page.count("<svg") == 6 and "data:image/png;base64,iVBORw==" in page and "a remark" in page
    assert not re.search(r"(?:src|href)=\"(?!data:)", page) and "nan" not in "".join(re.findall(r'd="[^"]*"', page))


def test_long_series_are_drawn_as_ranges(figures, tmp_path):
    """A day's bag gives a page of bounded size, in which a single peak still shows."""
    figures = json.loads(json.dumps(figures))
    values = [1.0] * 20_000
    values[7_000] = 50.0
    for name in ("edge_strain_percent", "area_strain_percent", "jitter_mm", "jitter_skinning_mm", "latency_us"):
        figures["series"][name] = values
    figures["series"]["time_s"] = [k / 60 for k in range(20_000)]
    path = tmp_path / "page.html"
    write_report(path, figures)
    page = path.read_text()
    assert len(page) < 300_000 and 'class="range model"' in page and ">50<" in page.replace("</text>", "<")


def test_missing_pictures_are_explained(draper, bag, monkeypatch):
    """Without mitsuba the page goes without them, and says what to install."""
    from physkin_ros.replay import report as replay_report

    def no_picture(*arguments, **settings):
        raise replay_report.PictureError("pictures need mitsuba: pip install 'physkin[view]'")

    monkeypatch.setattr(replay_report, "render", no_picture)
    found, _ = run(draper, bag)
    assert replay_report.thumbnails(found, draper, count=2) == (
        [],
        "No pictures: pictures need mitsuba: pip install 'physkin[view]'",
    )


def test_pictures_in_the_page(draper, bag):
    """First and last cloud, as PNG."""
    pytest.importorskip("mitsuba", reason="needs mitsuba: pip install 'physkin[view]'")
    found, _ = run(draper, bag)
    pictures, remark = thumbnails(found, draper, count=2)
    assert [caption for caption, _ in pictures] == ["0.00 s", "0.18 s"] and not remark
    assert all(png.startswith(b"\x89PNG") for _, png in pictures)


def test_convert_writes_what_the_clip_holds(tmp_path, capsys):
    """Names, positions and gravity of the shipped clip, gravity first, at its rate and at another."""
    path, motion = tmp_path / "walk.mcap", load_motion("walk")
    assert cli.main(["convert", "walk", str(path)]) == 0
    assert f"{motion.frame_count} joint states at 60 Hz" in capsys.readouterr().out
    entries = recorded(path)
    assert [topic for topic, *_ in entries] == ["/gravity", "/joint_states"] * motion.frame_count
    states = [message for topic, _, message in entries if topic == "/joint_states"]
    assert tuple(states[0].name) == motion.joint_names
    np.testing.assert_array_equal([state.position for state in states], motion.positions)
    down = [message.vector for topic, _, message in entries if topic == "/gravity"]
    np.testing.assert_allclose([[v.x, v.y, v.z] for v in down], motion.gravity)
    up = Rotation.from_quat(motion.root_orientation).inv().apply([0.0, 0.0, 1.0])
    np.testing.assert_allclose(motion.gravity, -up, atol=1e-6)
    times = np.array([time_ns for topic, time_ns, _ in entries if topic == "/joint_states"])
    np.testing.assert_allclose(np.diff(times), 1e9 / 60, atol=1)
    assert [state.header.stamp.sec * 10**9 + state.header.stamp.nanosec for state in states] == times.tolist()
    slow = tmp_path / "slow"
    assert cli.main(["convert", "walk", str(slow), "--rate", "30", "--seconds", "2", "--storage", "sqlite3"]) == 0
    assert len(recorded(slow)) == 2 * 60


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["replay", "{tmp}/none"], "does not exist"),
        (["replay", "{bag}", "--topic", "/clouds"], "topic /clouds is not in it; topics of sensor_msgs/msg/JointState"),
        (["replay", "{bag}", "--topic", "/gravity"], "topic /gravity is geometry_msgs/msg/Vector3Stamped"),
        (["replay", "{bag}", "--gravity-topic", "/up"], "topic /up is not in it"),
        (["replay", "{bag}", "-o", "{bag}"], "exists already"),
        (["replay", "{bag}", "-o", "{tmp}/no/out"], "there is no folder"),
        (["replay", "{bag}", "-o", "{tmp}/a.db3", "--storage", "mcap"], "would be a file of sqlite3, not of mcap"),
        (["replay", "{bag}", "--gravity", "0", "0", "0"], "must be three finite numbers"),
        (["replay", "{bag}", "--joint-map", "{tmp}/none.json"], "cannot read joint map"),
        (["replay", "{bag}", "--baseline", "{tmp}/none.json"], "cannot read baseline"),
        (["replay", "{tmp}/text.mcap"], "bag "),
        (["replay", "{tmp}/text.db3"], "bag "),
        (["replay", "{tmp}/strange.mcap", "-o", "{tmp}/out"], "none of the 1 joint states on /joint_states"),
        (["convert", "nosuch", "{tmp}/a.mcap"], "no bundled motion 'nosuch'"),
        (["convert", "{tmp}/none.bvh", "{tmp}/a.mcap"], "cannot read"),
        (["convert", "{tmp}/text.amc", "{tmp}/a.mcap"], "text.asf"),
    ],
)
def test_errors_are_one_line(quick, arguments, reason, bag, model_path, tmp_path, capsys):
    """Exit status 2, a sentence on stderr, and nothing left behind."""
    for suffix in (".mcap", ".db3", ".amc"):
        (tmp_path / f"text{suffix}").write_text("this is no bag" * 100)
    with BagWriter(tmp_path / "strange.mcap") as writer:
        writer.write("/joint_states", JOINT_STATE, joint_state(["tail"], [0.0]), 1)
    before = sorted(tmp_path.iterdir())
    filled = [word.format(bag=bag, tmp=tmp_path) for word in arguments]
    model = ["--model", str(model_path), "--contact-every", "0"] if filled[0] == "replay" else []
    assert cli.main([*filled, *model]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("error: ") and reason in line
    assert sorted(tmp_path.iterdir()) == before


def test_the_only_joint_states_are_found(tmp_path):
    """Another name is no obstacle; two of them are."""
    state = joint_state(["hip"], [0.0])
    for count in (1, 2):
        path = tmp_path / f"{count}.mcap"
        with BagWriter(path) as writer:
            for k in range(count):
                writer.write(f"/body{k}/joint_states", JOINT_STATE, state, 1)
        if count == 1:
            with BagReader(path) as bag:
                assert bag.topic == "/body0/joint_states" and bag.gravity_topic is None
                assert bag.joint_state_count == 1
        else:
            with pytest.raises(BagError, match="which topic.*/body0/joint_states, /body1/joint_states"):
                BagReader(path)


def test_failed_block_leaves_no_bag(tmp_path):
    """Half a bag would be taken for a whole one."""
    with pytest.raises(RuntimeError), BagWriter(tmp_path / "out") as writer:
        writer.write("/joint_states", JOINT_STATE, joint_state(["hip"], [0.0]), 1)
        raise RuntimeError
    assert not list(tmp_path.iterdir())


def test_clouds_that_are_not_finite_are_not_dense(tmp_path):
    """`is_dense` is honest."""
    points = np.zeros((4, 6), dtype=np.float32)
    points[1, 2] = np.inf
    with BagWriter(tmp_path / "out.mcap") as writer:
        writer.write_cloud("/garment", points, SimpleNamespace(sec=1, nanosec=2), "torso", 5)
    ((_, _, message),) = recorded(tmp_path / "out.mcap")
    assert not message.is_dense and message.header.frame_id == "torso"


def test_every_key_is_explained(figures):
    """docs/replay.md knows what --json writes."""
    text = (Path(__file__).parents[3] / "docs" / "replay.md").read_text()
    named = set(re.findall(r"`(\w+)`", text))
    keys = set(figures)
    for section in ("bag", "run", "counts", "figures", "series"):
        keys |= set(figures[section])
    keys |= set(figures["figures"]["jitter_mm"])
    assert keys - named == set()
