"""Warp and TensorFlow say nothing of their own in our commands' output."""

import re
import subprocess
import sys
from pathlib import Path

import physkin_training

SOURCES = Path(physkin_training.__file__).parent
CODE = """
from pathlib import Path
from physkin_training.quiet_warp import wp
from physkin_training.train.run_reports import scalar_writer

wp.zeros(3, device="cpu").fill_(1.0)
with scalar_writer(Path("scalars")) as writer:
    writer.add_scalar("energy", 1.0, 0)
"""


def test_neither_says_a_word(tmp_path):
    """With a TensorFlow that says something when it is loaded."""
    (tmp_path / "tensorflow.py").write_text("print('TensorFlow is here')")
    run = subprocess.run([sys.executable, "-c", CODE], capture_output=True, text=True, cwd=tmp_path)
    assert (run.returncode, run.stdout, run.stderr) == (0, "", "")
    assert list((tmp_path / "scalars").glob("events.*"))


def test_warp_comes_from_one_place():
    imports = re.compile("^ *(import|from) warp", re.M)
    assert [path.name for path in SOURCES.rglob("*.py") if imports.search(path.read_text())] == ["quiet_warp.py"]


def test_no_kernel_is_differentiated():
    """Backward passes, which nothing calls, would double the time that kernels take to compile."""
    kernels = [path for path in SOURCES.rglob("*.py") if "@wp.kernel" in path.read_text()]
    assert kernels and all('wp.set_module_options({"enable_backward": False})' in path.read_text() for path in kernels)
