"""Fixtures of the ROS tests: private ROS domains, processes that end with the test, and a peer to talk to."""

from __future__ import annotations

import dataclasses
import os
import signal
import subprocess
import sys
from contextlib import contextmanager
from types import SimpleNamespace

import numpy as np
import pytest
from random_models import random_sway_network

from physkin_core import BUNDLED_AVATAR, Draper, load_avatar, save_garment_model
from physkin_core.model.mlp import modulation_size


@pytest.fixture(scope="session")
def leaning_model(garment_model):
    """The test's garment, but of a cloth that swings by centimetres when the body leans."""
    (weight, bias), *layers = garment_model.pose_modulator
    weight = weight.copy()
    weight[:, -3:] *= 10_000  # the end of the pose vector is gravity
    return dataclasses.replace(garment_model, pose_modulator=((weight, bias), *layers))


@pytest.fixture(scope="session")
def leaning_model_path(leaning_model, tmp_path_factory):
    """A file of it."""
    path = tmp_path_factory.mktemp("models") / "leaning.safetensors"
    save_garment_model(leaning_model, path)
    return path


@pytest.fixture(scope="session")
def swaying_model_path(leaning_model, tmp_path_factory):
    """A file of the garment that heeds gravity, moved by a random sway network."""
    rng, nodes = np.random.default_rng(5), len(leaning_model.node_rest)
    network = random_sway_network(
        rng, len(leaning_model.rig.dofs), nodes, modulation=modulation_size(leaning_model.pose_modulator)
    )
    path = tmp_path_factory.mktemp("models") / "swaying.safetensors"
    save_garment_model(dataclasses.replace(leaning_model, name="swaying", sway=network), path)
    return path


@pytest.fixture(scope="session", autouse=True)
def domains_of_this_process():
    """Of processes that run tests side by side, each chooses among other ROS domains."""
    from physkin_ros.middleware import transport

    index, count = (
        os.environ.get(f"PYTEST_XDIST_WORKER{end}", default) for end, default in (("", "gw0"), ("_COUNT", "1"))
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(transport, "DOMAINS", transport.DOMAINS[int(index.removeprefix("gw")) :: int(count)])
        yield


@pytest.fixture(scope="module")
def domain():
    """A ROS domain of the module's own for this process and its children, on this machine only."""
    from physkin_ros.middleware.transport import private_environment

    with pytest.MonkeyPatch.context() as patch:
        for name, value in private_environment().items():
            if os.environ.get(name) != value:
                patch.setenv(name, value)
        yield int(os.environ["ROS_DOMAIN_ID"])


@contextmanager
def sites(environment: dict[str, str], tmp_path_factory):
    """Starts `physkin node --config` with given parameters, and a ROS node that listens to given garments.

    At the end the node must still be there, end well at SIGINT and have logged no traceback.
    """
    started = []

    def start(parameters: dict, garments):
        import yaml
        from drape_site import Site

        folder = tmp_path_factory.mktemp("site")
        config, log = folder / "avatars.yaml", folder / "log"
        config.write_text(yaml.safe_dump({"drape_node": {"ros__parameters": parameters}}, sort_keys=False))
        command = [sys.executable, "-m", "physkin_core.cli", "node", "--config", str(config)]
        with open(log, "w") as output:
            process = subprocess.Popen(command, stdout=output, stderr=subprocess.STDOUT, env=environment)
        started.append(Site(int(environment["ROS_DOMAIN_ID"]), process, garments, log))
        return started[-1]

    try:
        yield start
        for site in started:
            site.process.send_signal(signal.SIGINT)
            assert site.process.wait(60) == 0, site.log.read_text()
            text = site.log.read_text()
            assert "Traceback" not in text and "nanobind" not in text
    finally:
        for site in started:
            site.process.kill()
            site.process.wait()
            site.close()


@pytest.fixture(scope="module")
def start_site(domain, tmp_path_factory):
    """Starts a node's process, which ends with the module: see `sites`."""
    with sites(dict(os.environ), tmp_path_factory) as start:
        yield start


@pytest.fixture(scope="session")
def site_environment(domains_of_this_process):
    """Of the node's process that modules share: a ROS domain of its own."""
    from physkin_ros.middleware.transport import private_environment

    return private_environment()


@pytest.fixture(scope="session")
def start_shared_site(site_environment, tmp_path_factory):
    """The same of a process that ends with the session."""
    with pytest.MonkeyPatch.context() as patch, sites(site_environment, tmp_path_factory) as start:
        for name, value in site_environment.items():
            patch.setenv(name, value)
        yield start


@pytest.fixture
def start(domain):
    """Starts `python -m MODULE ARGUMENT...` in the domain; whatever still runs at the end is ended."""
    processes = []

    def start_module(module: str, *arguments: str) -> subprocess.Popen:
        command = [sys.executable, "-m", module, *arguments]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        processes.append(process)
        return process

    yield start_module
    for process in processes:
        if process.poll() is None:
            process.terminate()
            try:
                process.wait(60)
            except subprocess.TimeoutExpired:
                process.kill()
        process.stdout.close()


@pytest.fixture(scope="module")
def module_peer(domain):
    """The peer of all tests of a module."""
    pytest.importorskip("rclpy", reason="needs rclpy: pip install 'physkin[ros]'")
    from drape_site import Peer

    peer = Peer(domain)
    yield peer
    peer.close()


@pytest.fixture
def peer(module_peer):
    """A ROS node of the tests' own that sends joint states and gravity, and collects what the drape node publishes."""
    for collected in (module_peer.clouds, module_peer.frame_ids, module_peer.reports):
        collected.clear()
    return module_peer


@pytest.fixture(scope="module")
def shared_loader(asset_loader):
    """Nodes of this process have one process that loads, which they do not end."""
    from physkin_ros.node import asset_loading

    lent = SimpleNamespace(outfit=asset_loader.outfit, cancel=asset_loader.cancel, close=lambda: None)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(asset_loading, "AssetLoader", lambda **_: lent)
        yield


@pytest.fixture
def outfit_loader(shared_loader):
    """What a node loads with."""
    from physkin_ros.node.asset_loading import OutfitLoader

    return OutfitLoader(seconds=60.0, memory=1024)


@pytest.fixture(scope="module")
def running_node(module_peer, shared_loader):
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


@pytest.fixture(scope="session")
def draper(garment_model) -> Draper:
    """What the node should compute."""
    return Draper(garment_model, load_avatar(BUNDLED_AVATAR, garment_model.rig))
