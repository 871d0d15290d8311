"""Lines of log of a training run."""

from __future__ import annotations

import logging
from types import SimpleNamespace

import pytest

from physkin_training.train.run_reports import RunReports
from physkin_training.train.trainer import TERMS


@pytest.mark.parametrize(
    "step, skipped, said",
    [(500, 0, "1000 samples/s  0.8 minutes left"), (900, 400, "1000 samples/s  0.2 minutes left")],
    ids=["all were done", "400 were left out"],
)
def test_steps_that_were_left_out_took_no_time(tmp_path, caplog, step, skipped, said):
    """500 steps of 100 samples in 50 s, of 1,000."""
    optimisation = SimpleNamespace(samples=100, steps=1000)
    trainer = SimpleNamespace(step=0, skipped=skipped, config=SimpleNamespace(optimisation=optimisation))
    row = dict.fromkeys(TERMS, 0.0) | {"step": step, "seconds": 50.0, "range": 1.0}
    row["median_stretch_and_collision"] = 0.0
    with caplog.at_level(logging.INFO):
        RunReports(trainer, tmp_path, every=1)._log(row)
    assert said in caplog.text
