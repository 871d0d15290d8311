"""Kernels are compiled before the time of a command begins to count."""

import logging
import os
import subprocess
import sys

import pytest
import torch

from physkin_training import compiled_kernels
from physkin_training.compiled_kernels import compile_kernels

CODE = """
import os
from pathlib import Path

import numpy as np
import torch

from physkin_training.compiled_kernels import compile_kernels
from physkin_training.contact.surface_queries import BodySurface

compile_kernels(torch.device("cpu"))
compiled = sorted(Path(os.environ["WARP_CACHE_PATH"]).rglob("*.o"))
BodySurface(np.eye(3), [[0, 1, 2]]).closest(np.zeros((1, 3)))
assert compiled and compiled == sorted(Path(os.environ["WARP_CACHE_PATH"]).rglob("*.o"))
"""


@pytest.mark.slow
def test_what_is_compiled_is_what_is_run(tmp_path):
    """In a process of its own whose cache is empty: a kernel that is launched afterwards is not compiled again."""
    surroundings = os.environ | {"WARP_CACHE_PATH": str(tmp_path)}
    subprocess.run([sys.executable, "-c", CODE], env=surroundings, check=True)


@pytest.mark.parametrize(("took", "said"), [(0.0, 0), (-1.0, 1)])
def test_only_time_that_is_noticed_is_mentioned(took, said, monkeypatch, caplog):
    """For a GPU the CPU's kernels are compiled, too: it checks meshes there."""
    loaded = []
    monkeypatch.setattr(compiled_kernels.wp, "load_module", lambda module, devices, **_: loaded.append(devices))
    monkeypatch.setattr(compiled_kernels, "NOTICED", compiled_kernels.NOTICED if said == 0 else took)
    with caplog.at_level(logging.INFO, logger="physkin_training"):
        compile_kernels(torch.device("cuda", 0))
        compile_kernels(torch.device("cpu"))
    assert loaded == [["cpu", "cuda:0"], ["cpu"]]
    assert len([line for line in caplog.messages if "not counted in --minutes" in line]) == 2 * said
