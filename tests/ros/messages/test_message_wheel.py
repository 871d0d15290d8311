"""The build of the message wheel, without building it."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest

BUILD = Path(__file__).parents[3] / "msg_defs" / "wheel" / "build.py"


@pytest.fixture
def build():
    """The build script as a module of its own."""
    specification = importlib.util.spec_from_file_location("message_wheel_build", BUILD)
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


@pytest.mark.parametrize("built", [False, True])
def test_colcon_passes_the_work_folder_by(build, tmp_path, monkeypatch, built):
    """Whether the wheel is there already or its build fails: below a clone, colcon must not find our package twice."""

    def fail(work):
        raise build.BuildError("no generators")

    monkeypatch.setattr(build, "_build_environment", fail)
    work = tmp_path / "build" / "messages"
    if built:
        wheel = work / build._fingerprint() / build._wheel_name()
        wheel.parent.mkdir(parents=True)
        wheel.touch()
        assert build.build_wheel(work) == wheel
    else:
        with pytest.raises(build.BuildError, match="no generators"):
            build.build_wheel(work)
    assert (work / "COLCON_IGNORE").is_file()


@pytest.mark.parametrize(
    ("there", "generator", "others"),
    [(False, None, False), (True, "physkin", False), (True, "bdist", True), (True, None, True)],
)
def test_tf_messages_of_others_are_left_alone(build, monkeypatch, there, generator, others):
    """Those of a ROS installation, which bears no wheel's mark, and of another wheel; our own are built anew."""

    class Distribution:
        read_text = staticmethod(lambda name: f"Wheel-Version: 1.0\nGenerator: {generator}\n")

    def distribution(name):
        if generator is None:
            raise build.importlib.metadata.PackageNotFoundError(name)
        return Distribution

    monkeypatch.setattr(build.importlib.util, "find_spec", lambda name: object() if there else None)
    monkeypatch.setattr(build.importlib.metadata, "distribution", distribution)
    assert build._has_tf_messages_of_others() is others


def test_both_packages_say_what_they_are(build):
    """The TF message must be what ROS 2 calls so, or nobody hears it."""
    assert build._name_and_version(build.PACKAGE)[0] == "physkin_msgs"
    assert build._name_and_version(build.TF_PACKAGE)[0] == "tf2_msgs"
    lines = (build.TF_PACKAGE / "msg" / "TFMessage.msg").read_text().splitlines()
    declared = [line for line in lines if line and not line.startswith("#")]
    assert declared == ["geometry_msgs/TransformStamped[] transforms"]
    assert (build.TF_PACKAGE / "COLCON_IGNORE").is_file(), "colcon takes the one of the ROS installation"
