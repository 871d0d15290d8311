"""Steps of any size, layout and content: computed, refused or carried through, never out of bounds, never swallowed.

What lies around an output is filled with a mark, so that a kernel that writes beyond its rows is seen; reads beyond
are seen by the sanitized builds of test_native_build.py.
"""

import os
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from native_frames import NativeFrame, told
from reference.frame import ReferenceFrame

from physkin_core.runtime.evaluator import PRECISIONS, supported_instruction_sets

LEVELS = supported_instruction_sets()
ANY_FLOAT = st.floats(width=32, allow_nan=True, allow_infinity=True)
EXAMPLES = 40
UNTIMED = [HealthCheck.function_scoped_fixture, HealthCheck.too_slow]  # a first draw reads all sources for constants
COMMON = dict(deadline=None, suppress_health_check=UNTIMED, derandomize=True)

sizes = st.fixed_dictionaries(
    dict(
        bones=st.integers(1, 9),
        dofs=st.integers(0, 11),
        nodes=st.integers(1, 40),
        vertices=st.integers(1, 70),
        influences=st.integers(1, 9),
        pose_widths=st.lists(st.integers(1, 70), max_size=3).map(tuple),
        deformer_widths=st.lists(st.integers(1, 70), min_size=1, max_size=3).map(tuple),
    )
)


def check_any_step(data, level, make_garment, make_pose):
    """One drawn garment, precision, layout and pose."""
    shape = data.draw(sizes)
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32)))
    precision = data.draw(st.sampled_from(PRECISIONS))
    detail_nodes = shape["vertices"] if data.draw(st.booleans()) else 0
    garment, face_count = make_garment(rng, **shape, detail_nodes=detail_nodes), data.draw(st.integers(0, 140))
    faces = rng.integers(0, shape["vertices"], size=(face_count, 3)).astype(np.int32)
    garment = replace(garment, faces=faces)
    frame = NativeFrame([garment], instruction_set=level, precision=precision)
    pose, gravity = make_pose(rng, garment)
    inputs = np.concatenate([pose, gravity])
    for index, value in data.draw(st.dictionaries(st.integers(0, len(inputs) - 1), ANY_FLOAT, max_size=2)).items():
        inputs[index] = value
    pose, gravity = inputs[: len(pose)], inputs[len(pose) :]

    n, columns = shape["vertices"], data.draw(st.sampled_from([3, 6]))
    stride, offset = data.draw(st.integers(columns, 20)), data.draw(st.integers(0, 67))
    message = bytearray(b"\xa5" * (offset + 4 * stride * n + 64))
    rows = np.frombuffer(message, dtype=np.float32, count=stride * n, offset=offset).reshape(n, stride)
    out = rows[:: data.draw(st.sampled_from([1, -1])), :columns]
    try:
        frame.evaluate(pose, told(gravity)[None], [out])
    except ValueError as error:
        assert "finite" in str(error)
        # Refused only for a reason: an input that is not finite, or so large that what comes of it is not.
        assert not np.isfinite(inputs).all() or np.abs(inputs).max() > 1e2, error
        assert set(message) == {0xA5}
        return
    assert np.isfinite(inputs).all() and np.isfinite(out).all()
    around = np.frombuffer(message, dtype=np.uint8).copy()
    inside = np.zeros(len(around), dtype=bool)
    inside[offset : offset + 4 * stride * n].reshape(n, 4 * stride)[:, : 4 * columns] = True
    assert (around[~inside] == 0xA5).all()
    if precision == "fp32" and np.abs(inputs).max() < 10:
        expected = np.empty_like(out)
        ReferenceFrame([garment]).evaluate(pose, told(gravity)[None], [expected])
        assert np.abs(out[:, :3] - expected[:, :3]).max() <= 1e-4 * max(1, np.abs(expected[:, :3]).max())


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize(
    "examples", [EXAMPLES, pytest.param(int(os.environ.get("PHYSKIN_FUZZ_EXAMPLES", 3000)), marks=pytest.mark.slow)]
)
def test_any_step(examples, level, make_garment, make_pose):
    @settings(max_examples=examples, **COMMON)
    @given(st.data())
    def any_step(data):
        check_any_step(data, level, make_garment, make_pose)

    any_step()
