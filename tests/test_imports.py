"""The run time stays light: importing it loads nothing that only training, the ROS node or the loaders need."""

import subprocess
import sys

import pytest

HEAVY = ("torch", "warp", "rclpy", "trimesh", "pygltflib")


MODULES = ("physkin_core", "physkin_core.runtime.evaluator", "physkin_core.cli", "physkin_core.bench")
MODULES += ("physkin_training.config",)  # reading a configuration needs no torch
QUICK = ("physkin_core", "physkin_core.cli")  # what every command waits for; scipy would be half of it


@pytest.mark.parametrize("module", MODULES)
def test_import_loads_no_heavy_package(module, tmp_path):
    code = f"import sys, {module}; print(*sorted({{name.split('.')[0] for name in sys.modules}}))"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    loaded = set(result.stdout.split())
    assert "physkin_core" in loaded
    assert loaded.isdisjoint(HEAVY), loaded & set(HEAVY)
    if module in QUICK:
        assert "scipy" not in loaded
