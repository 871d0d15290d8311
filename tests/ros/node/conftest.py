"""Drape nodes in the tests' own process, and what they should compute."""

from __future__ import annotations

from contextlib import contextmanager

import pytest

from physkin_core import BUNDLED_AVATAR, Draper, load_avatar, load_garment_model


@pytest.fixture(scope="module")
def running_node(module_peer):
    """Runs a drape node with these parameters in the peer's executor, ten reports a second."""
    from rclpy.parameter import Parameter

    from physkin_ros.node import reports
    from physkin_ros.node.drape_node import DrapeNode

    @contextmanager
    def run(parameters: dict, *, gravity: bool = True, connect: bool = True):
        overrides = [Parameter(name, value=value) for name, value in parameters.items()]
        node = DrapeNode(context=module_peer.context, parameter_overrides=overrides)
        module_peer.executor.add_node(node)
        try:
            if connect:
                module_peer.connect(gravity=gravity, settle=0.1)
            yield node
        finally:
            node.destroy_node()

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(reports, "PERIOD", 0.1)
        yield run


@pytest.fixture(scope="module")
def other_body(tmp_path_factory):
    """A body a tenth larger than the bundled one, in a folder of its own."""
    from drape_site import scaled_body

    path = tmp_path_factory.mktemp("bodies") / "other.glb"
    path.write_bytes(scaled_body(1.1))
    return path


@pytest.fixture(scope="session")
def draper(garment_model) -> Draper:
    """What the node should compute."""
    return Draper(garment_model, load_avatar(BUNDLED_AVATAR, garment_model.rig))


@pytest.fixture(scope="session")
def leaning_draper(leaning_model_path) -> Draper:
    """The same of the garment that gravity moves."""
    model = load_garment_model(leaning_model_path)
    return Draper(model, load_avatar(BUNDLED_AVATAR, model.rig))
