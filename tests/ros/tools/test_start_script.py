"""The start-up script finds the installation that it is told of."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[3] / "physkin_ros" / "examples" / "start_drape_node.sh"


def write_python(folder: Path, name: str) -> None:
    """A python3 in the folder that prints its name, the workspace that was sourced, and its arguments."""
    folder.mkdir(parents=True)
    (folder / "python3").write_text(f'#!/bin/sh\necho "{name} ${{SOURCED:-nothing}} $*"\n')
    (folder / "python3").chmod(0o755)


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ((), "system nothing"),
        (("PHYSKIN_ENV",), "environment nothing"),
        (("PHYSKIN_WORKSPACE",), "system workspace"),
        (("PHYSKIN_ENV", "PHYSKIN_WORKSPACE"), "environment workspace"),
    ],
)
def test_environment_and_workspace(given, expected, tmp_path):
    """A virtual environment, a colcon workspace, or one built within the other."""
    folders = {"PHYSKIN_ENV": tmp_path / "environment", "PHYSKIN_WORKSPACE": tmp_path / "workspace"}
    write_python(tmp_path / "system", "system")
    write_python(tmp_path / "environment" / "bin", "environment")
    (tmp_path / "workspace" / "install").mkdir(parents=True)
    (tmp_path / "workspace" / "install" / "setup.bash").write_text("export SOURCED=workspace$NOT_SET\n")
    environment = {"PATH": f"{tmp_path / 'system'}{os.pathsep}/usr/bin{os.pathsep}/bin", "AMENT_PREFIX_PATH": "/some"}
    environment |= {name: str(folders[name]) for name in given}
    ran = subprocess.run(
        ["bash", SCRIPT, "one.yaml", "--ros-args"], env=environment, capture_output=True, text=True, check=True
    )
    assert ran.stdout == f"{expected} -m physkin_ros --config one.yaml --ros-args\n"
