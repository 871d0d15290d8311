"""The run time stays light: importing it loads nothing that only training, the ROS node or the loaders need."""

import subprocess
import sys

HEAVY = ("torch", "warp", "rclpy", "trimesh", "pygltflib")
QUICK = "physkin_core.cli"  # what every command waits for; scipy would be half of it
MODULES = ("physkin_core.bench", "physkin_core.runtime.evaluator", "physkin_training.config")


def test_imports_load_no_heavy_package(tmp_path):
    """Neither the command and all that it imports, nor then what benchmarks and configurations need."""
    report = "print(*sorted({name.split('.')[0] for name in sys.modules}))"
    code = f"import sys, {QUICK}; {report}; import {', '.join(MODULES)}; {report}"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    quick, all_of_them = (set(line.split()) for line in result.stdout.splitlines())
    assert "physkin_core" in quick and quick.isdisjoint((*HEAVY, "scipy"))
    assert all_of_them.isdisjoint(HEAVY), all_of_them & set(HEAVY)
