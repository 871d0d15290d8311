"""Made-up records of a trial."""

from __future__ import annotations

import numpy as np
import pytest

MILLISECOND = 1_000_000


@pytest.fixture(scope="session")
def made_records():
    """Makes records of joint states sent to `avatars` avatars in turn, 5 ms apart, whose clouds come after `delays_ms`.

    None: a cloud that is lost. repeated: clouds that come twice. strangers: clouds of stamps that were not sent.
    """
    from physkin_ros.tools.trial import Records

    def made(delays_ms, *, avatars=1, repeated=(), strangers=0, **fields) -> Records:
        stamps = np.arange(len(delays_ms), dtype=np.int64).reshape(-1, avatars) * 5 * MILLISECOND
        sent = [
            (k % avatars, stamp, stamp + d * MILLISECOND if d else None)
            for k, (stamp, d) in enumerate(zip(stamps.ravel().tolist(), delays_ms))
        ]
        came = [each for each in sent if each[2]] + [sent[k] for k in repeated] + [(0, -7, 0)] * strangers
        whose, kept, received = np.array(came[::-1], dtype=np.int64).reshape(-1, 3).T
        usual = {"cpu": np.array([0.0036, 0.0054]), "load": 2.0, "not_finite": 0, "kept_stamps": kept[:0]}
        pairs = [("50.0", "70.0"), ("none", "none"), ("54.0", "90.0"), ("52.0", "80.0")]
        reports = [{"evaluation p50 [us]": p50, "evaluation p99 [us]": p99} for p50, p99 in pairs]
        usual |= {"kept": np.zeros((0, 1, 6)), "reports": reports, "garments": np.zeros_like(whose)}
        return Records(stamps=stamps, avatars=whose, received_stamps=kept, received=received, **usual | fields)

    return made
