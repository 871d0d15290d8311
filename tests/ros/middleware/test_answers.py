"""Each request of a drape node's services is answered, and simulated time that stands keeps nobody waiting."""

from __future__ import annotations

import pytest

pytest.importorskip("rclpy", reason="needs rclpy: pip install 'physkin[ros]'")

from drape_site import text_parameter  # noqa: E402
from lifecycle_msgs.msg import Transition  # noqa: E402
from lifecycle_msgs.srv import ChangeState, GetState  # noqa: E402
from rcl_interfaces.msg import Parameter, ParameterValue  # noqa: E402
from rcl_interfaces.srv import GetParameters, SetParameters, SetParametersAtomically  # noqa: E402


@pytest.fixture(scope="module")
def bodies(running_node, model_path, tmp_path_factory):
    """The folder that bodies of a running node may come from."""
    folder = tmp_path_factory.mktemp("bodies")
    one, other = folder / "one.glb", folder / "other.glb"
    one.symlink_to(other)
    other.symlink_to(one)
    with running_node({"use_sim_time": True, "asset_roots": [str(folder)], "model": str(model_path)}):
        yield folder


def test_simulated_time_that_stands_stops_no_report(bodies, peer):
    """There is no /clock here."""
    peer.until(lambda: peer.reports, "diagnostics")


@pytest.mark.parametrize("name", ["n" * 300, "one.glb", "\x1b[2J\nforged", "n" * 100_000])
def test_bodies_that_cannot_be_are_refused(bodies, peer, name, capfd):
    """A name that is too long for a file, one in a circle of links, one that would forge a line of the log."""
    path = str(bodies / name)
    both = [text_parameter("body_mesh", path), text_parameter("body_mesh", path)]
    for result in peer.call(SetParameters, "set_parameters", parameters=both).results:
        assert not result.successful and result.reason.isprintable() and 10 < len(result.reason) <= 300
    result = peer.call(SetParametersAtomically, "set_parameters_atomically", parameters=both[:1]).result
    assert not result.successful
    services = pytest.importorskip("physkin_msgs.srv", reason="needs physkin_msgs")
    answer = peer.call(services.SetBody, "set_body", avatar="", body_mesh=path)
    assert not answer.success and answer.message.isprintable() and 10 < len(answer.message) <= 300
    log = capfd.readouterr().err
    assert "\x1b" not in log and "\nforged" not in log


@pytest.mark.parametrize(
    "transition", [{"id": 1}, {"id": 2}, {"id": 77}, {"id": 255}, {"label": "nosuch"}, {"label": "cleanup"}]
)
def test_transitions_that_cannot_be_are_refused(bodies, peer, transition):
    """The node goes on as it is."""
    assert not peer.call(ChangeState, "change_state", transition=Transition(**transition)).success
    assert peer.call(GetState, "get_state").current_state.label == "active"


def test_parameters_that_are_none_are_refused(bodies, peer):
    """Of no type that there is, and of no name."""
    odd = [Parameter(name="sway", value=ParameterValue(type=99)), Parameter(name="nosuch" * 1000)]
    results = peer.call(SetParameters, "set_parameters", parameters=odd).results
    assert len(results) == 2 and not any(result.successful for result in results)
    assert peer.call(GetParameters, "get_parameters", names=["nosuch"]).values == []
