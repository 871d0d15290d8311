"""What `colcon build` installs of physkin_ros: its CMake build, with ament from the ROS 2 wheels."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
BUILD = ROOT / "msg_defs" / "wheel" / "build.py"


def files(folder: Path) -> set[Path]:
    """Files below the folder, relative to it, without what Python leaves."""
    found = {path.relative_to(folder) for path in folder.rglob("*") if path.is_file()}
    return {path for path in found if "__pycache__" not in path.parts}


@pytest.mark.slow
def test_everything_is_installed(tmp_path):
    """Both packages, the native module, what `ros2 run` and `ros2 launch` look for, and a `physkin` that runs."""
    specification = importlib.util.spec_from_file_location("message_wheel_build", BUILD)
    wheel_build = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(wheel_build)
    ament = wheel_build._build_environment(wheel_build.DEFAULT_WORK).parent
    nanobind = tmp_path / "nanobind"
    subprocess.run([sys.executable, "-m", "pip", "install", "-q", "--target", nanobind, "nanobind"], check=True)
    prefix, environment = tmp_path / "install", wheel_build._without_ros(os.environ)
    environment["PATH"] = f"{ament}{os.pathsep}{environment['PATH']}"
    environment["CMAKE_PREFIX_PATH"] = environment["AMENT_PREFIX_PATH"] = str(ament.parent)
    options = [f"-DCMAKE_INSTALL_PREFIX={prefix}", f"-Dnanobind_DIR={nanobind}/nanobind/cmake"]
    options += [
        "-DCMAKE_BUILD_TYPE=Debug",
        f"-DPython_EXECUTABLE={ament / 'python'}",
        f"-DPython3_EXECUTABLE={ament / 'python'}",
    ]
    for command in (
        ["cmake", "-S", ROOT / "physkin_ros", "-B", tmp_path / "build", "-G", "Ninja", *options],
        ["cmake", "--build", tmp_path / "build", "--target", "install"],
    ):
        subprocess.run(command, check=True, env=environment)
    (site,) = prefix.glob("lib/python3*/site-packages")
    for package in ("physkin_core", "physkin_ros"):
        assert files(ROOT / package) - files(site / package) == set()
    assert list((site / "physkin_core").glob("_native.*.so"))
    share = prefix / "share"
    for folder in ("config", "examples", "launch"):
        assert files(share / "physkin_ros" / folder) == files(ROOT / "physkin_ros" / folder)
    assert (share / "physkin_ros" / "package.xml").is_file()
    assert (share / "ament_index" / "resource_index" / "packages" / "physkin_ros").is_file()
    programs = ("lib/physkin_ros/drape_node", "bin/physkin", "share/physkin_ros/examples/start_drape_node.sh")
    assert [name for name in programs if not os.access(prefix / name, os.X_OK)] == []
    ran = subprocess.run(
        [sys.executable, prefix / "bin" / "physkin", "info", "tshirt"],
        env={**os.environ, "PYTHONPATH": str(site)},
        capture_output=True,
        text=True,
    )
    assert ran.returncode == 0 and "made to measure" in ran.stdout, ran.stderr
