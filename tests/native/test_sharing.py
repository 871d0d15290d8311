"""Evaluators of one process keep once what is equal in them: network weights, influences, rings."""

import gc
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from native_frames import NativeFrame, clouds, told

from physkin_core.runtime.evaluator import PRECISIONS

MEASURED = """
import gc, sys
from conftest import random_bound_garment
import numpy as np
from dataclasses import replace
from physkin_core.runtime.evaluator import Evaluator

def resident():
    gc.collect()
    return int(open("/proc/self/statm").read().split()[1]) * 4096

garment = random_bound_garment(np.random.default_rng(0), vertices=6000, nodes=64, pose_widths=(512,) * 4)
on_another_body = replace(garment, vertices=1.01 * garment.vertices)
Evaluator([on_another_body])  # whatever is needed once
before = resident()
kept = [Evaluator([garment])]
first = resident() - before
kept += [Evaluator([replace(garment, vertices=garment.vertices + np.float32(k))]) for k in range(10)]
others = (resident() - before - first) / 10
kept.clear()
for _ in range(30):
    Evaluator([garment])
print(first, others, resident() - before)
"""


def frame(garment, **options):
    pose = np.random.default_rng(1).uniform(garment.dof_lower, garment.dof_upper).astype(np.float32)
    return clouds(NativeFrame([garment], **options), [garment], pose, told())[0]


@pytest.mark.parametrize("precision", PRECISIONS)
def test_network_weights_that_differ_are_not_taken_for_each_other(make_garment, precision):
    """Signs, or the order of rows or columns, are enough, whatever other evaluators live; so is a change in place after
    an evaluator was built."""
    garment = make_garment(np.random.default_rng(0))
    living = NativeFrame([garment], precision=precision)
    plain = frame(garment, precision=precision)
    weight, bias = garment.pose_layers[0]
    for changed in (weight * -1, np.roll(weight, 1, axis=0), weight[:, ::-1].copy()):
        other = replace(garment, pose_layers=((changed, bias), *garment.pose_layers[1:]))
        assert not np.array_equal(frame(other, precision=precision), plain)
    rolled = np.roll(garment.influence_weights, 1, axis=1)
    assert not np.array_equal(frame(replace(garment, influence_weights=rolled), precision=precision), plain)
    np.testing.assert_array_equal(frame(garment, precision=precision), plain)
    bias += 1
    assert not np.array_equal(frame(garment, precision=precision), plain)
    assert living.precision == precision


def test_what_is_shared_outlives_the_evaluator_that_made_it(make_garment):
    """And what comes into its place does not disturb it."""
    rng = np.random.default_rng(0)
    garment, pose = make_garment(rng), None
    first = NativeFrame([garment])
    second = NativeFrame([garment])
    pose = np.zeros(len(garment.dof_rest), dtype=np.float32)
    (expected,) = clouds(first, [garment], pose, told())
    del first
    gc.collect()
    others = [NativeFrame([make_garment(rng)]) for _ in range(5)]
    np.testing.assert_array_equal(clouds(second, [garment], pose, told())[0], expected)
    assert len(others) == 5


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc/self/statm")
def test_another_body_takes_a_fraction_of_the_memory():
    """Measured in a process of its own. Other bodies have rest shapes of their own, the network weights are the same: a
    third of the first evaluator's memory leaves room for the pages of what is built meanwhile. What is given back is
    used again: thirty more in turn take no more than three at once would."""
    here = Path(__file__).parent
    paths = os.environ | {"PYTHONPATH": os.pathsep.join(map(str, (here, here.parent)))}
    run = subprocess.run([sys.executable, "-c", MEASURED], env=paths, check=True, capture_output=True, text=True)
    first, others, left = map(float, run.stdout.split())
    assert others < first / 3 and left < 3 * first
