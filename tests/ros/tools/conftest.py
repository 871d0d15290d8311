"""Made-up records of a trial."""

from __future__ import annotations

import numpy as np
import pytest


@pytest.fixture(scope="session")
def made_records():
    """Makes records of joint states sent to `avatars` avatars in turn, whose clouds come after `delays_ms`; None: a
    cloud that is lost. repeated: clouds that come twice."""
    from physkin_ros.tools.trial import Records

    def made(delays_ms, *, avatars=1, repeated=(), **fields) -> Records:
        delays = np.array(delays_ms, dtype=float).reshape(-1, avatars, 1)  # of None: NaN
        counts = np.isfinite(delays).astype(float)
        counts.ravel()[list(repeated)] = 2
        pairs = [("50.0", "70.0"), ("none", "none"), ("54.0", "90.0"), ("52.0", "80.0")]
        usual = {"reports": [{"evaluation p50 [us]": p50, "evaluation p99 [us]": p99} for p50, p99 in pairs]}
        usual |= {"measured": [(1.0, 2.0), (1.0036, 2.0054)]}
        return Records(counts, delays, **usual | fields)

    return made
