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
