"""The drape node in the test's own process: what it makes of good and bad joint states."""

from __future__ import annotations

import numpy as np
import pytest

from physkin_core import BUNDLED_AVATAR, Draper, load_avatar

pytest.importorskip("rclpy", reason="needs rclpy: pip install 'physkin[ros]'")

from rclpy.parameter import Parameter  # noqa: E402

from physkin_ros.drape_node import DrapeNode  # noqa: E402


@pytest.fixture
def drape_node(peer, model_path):
    """A node that drapes the test's garment on the bundled avatar."""
    node = DrapeNode(context=peer.context, parameter_overrides=[Parameter("model", value=str(model_path))])
    peer.executor.add_node(node)
    peer.connect()
    yield node
    node.destroy_node()


@pytest.fixture(scope="module")
def draper(garment_model) -> Draper:
    """What the node should compute."""
    return Draper(garment_model, load_avatar(BUNDLED_AVATAR, garment_model.rig))


def test_order_extra_and_missing_joints(peer, drape_node, draper):
    """Joints in any order; unknown ones are ignored, missing ones keep their last position, at first the rest."""
    names, rig = np.array(draper.joint_names), draper.model.rig
    random = np.random.default_rng(1)
    state = rig.rest.astype(np.float32)
    np.testing.assert_array_equal(peer.cloud(names[:1], state[:1], (1, 0)), draper.drape(state))
    state = random.uniform(rig.lower, rig.upper).astype(np.float32)
    order = random.permutation(len(names))
    cloud = peer.cloud([*names[order], "tail"], [*state[order], 9.0], (2, 0))
    np.testing.assert_array_equal(cloud, draper.drape(state))
    state[3:5] = 0.1, 0.2
    np.testing.assert_array_equal(peer.cloud(names[3:5], state[3:5], (3, 0)), draper.drape(state))


def test_stamps_are_verbatim(peer, drape_node, draper):
    """Clouds carry the joint states' stamps to the nanosecond, also ones that jump back, and the frame asked for."""
    stamps = [(0, 0), (1, 999_999_999), (2_000_000_000, 1), (7, 3)]
    for stamp in stamps:
        peer.cloud(draper.joint_names, draper.model.rig.rest, stamp)
    assert sorted(peer.clouds) == sorted(stamps)
    assert peer.frame_ids == {"base_link"}


def test_bad_joint_states_leave_the_last_good_state(peer, drape_node, draper, capfd):
    """Each is warned about and shows in the diagnostics, no cloud answers it, and the next one goes on from before."""
    names = list(draper.joint_names)
    good = np.linspace(-0.2, 0.2, len(names)).astype(np.float32)
    peer.cloud(names, good, (1, 0))
    bad = [
        (names, [*good[:-1], np.nan], f"{names[-1]!r} is nan"),
        (names, [np.inf, *good[1:]], f"{names[0]!r} is inf"),
        (names, good[:-1], f"{len(names)} names but {len(names) - 1} positions"),
        (["tail", "fin"], [0.0, 0.0], "no joint is known among tail, fin"),
        ([names[0], names[0]], [0.0, 1.0], "are the same joint"),
        ([], [], "names no joints"),
    ]
    for count, (bad_names, values, reason) in enumerate(bad, start=1):
        peer.send(bad_names, values, (2, count))
        peer.spin_until(lambda n=count: _latest(peer, "joint states rejected") == str(n), "diagnostics")
        assert reason in _latest(peer, "last rejection")
    assert "joint state ignored: the position of joint" in capfd.readouterr().err
    assert list(peer.clouds) == [(1, 0)]
    good[2] = 0.15
    np.testing.assert_array_equal(peer.cloud(names[2:3], good[2:3], (3, 0)), draper.drape(good))


def test_diagnostics(peer, drape_node, draper):
    """Once a second, with what a person who looks for a fault needs."""
    for index in range(5):
        peer.cloud(draper.joint_names, draper.model.rig.rest, (index, 0))
    peer.spin_until(lambda: _latest(peer, "clouds published") == "5", "diagnostics")
    report = next(report for report in peer.reports if report["evaluation p50 [us]"] != "none")
    assert 0 < float(report["evaluation p50 [us]"]) <= float(report["evaluation p99 [us]"])
    assert (report["model"], report["backend"]) == ("vest", "native")
    assert report["instruction set"] in ("baseline", "v3", "v4")
    assert float(report["last stamp age [s]"]) > 0


def test_gravity_can_change_while_running(peer, drape_node, draper):
    """A tilted root is draped as such; a direction that is none is refused."""
    names, rest = draper.joint_names, draper.model.rig.rest
    down = [0.0, 0.6, -0.8]
    (result,) = drape_node.set_parameters([Parameter("gravity", value=down)])
    assert result.successful
    np.testing.assert_array_equal(peer.cloud(names, rest, (1, 0)), draper.drape(rest, np.array(down)))
    (result,) = drape_node.set_parameters([Parameter("gravity", value=[0.0, 0.0, 0.0])])
    assert not result.successful and "three finite numbers" in result.reason
    (result,) = drape_node.set_parameters([Parameter("model", value="dress")])
    assert not result.successful


def _latest(peer, key: str) -> str:
    return peer.reports[-1][key] if peer.reports else ""
