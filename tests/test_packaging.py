"""The wheel holds every file of the packages, the native module, and asks for nothing heavy."""

import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = {
    "physkin_core": "physkin_core",
    "physkin_ros": "physkin_ros",
    "physkin_training": "training/physkin_training",
    "physkin_bench": "native/physkin_bench",
}
NOT_SHIPPED = ("__pycache__", "CMakeLists.txt", "package.xml", ".so")


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", folder, ROOT]
    subprocess.run(command, check=True)
    (path,) = folder.glob("physkin-*.whl")
    with zipfile.ZipFile(path) as archive:
        yield archive


def test_wheel_holds_every_file(wheel):
    """Data files too: a model or a map that is left out is missed only on the user's machine."""
    names = set(wheel.namelist())
    for package, folder in PACKAGES.items():
        files = [path for path in (ROOT / folder).rglob("*") if path.is_file()]
        wanted = {f"{package}/{path.relative_to(ROOT / folder)}" for path in files}
        wanted = {name for name in wanted if not any(part in name for part in NOT_SHIPPED)}
        assert f"{package}/__init__.py" in wanted
        assert wanted - names == set()
    assert any(name.startswith("physkin_core/_native.") for name in names)
    assert "physkin_core/libphyskin_c.so" in names


def test_plain_install_needs_nothing_heavy(wheel):
    (metadata,) = [name for name in wheel.namelist() if name.endswith(".dist-info/METADATA")]
    lines = wheel.read(metadata).decode().splitlines()
    plain = [line.lower() for line in lines if line.startswith("Requires-Dist:") and "extra ==" not in line]
    assert plain
    assert [line for line in plain for heavy in ("torch", "warp", "anny", "rclpy", "mitsuba") if heavy in line] == []
