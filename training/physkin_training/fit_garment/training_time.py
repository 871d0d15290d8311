"""How many steps a garment is trained for in the minutes that the whole command has."""

from __future__ import annotations

import logging
import math

from physkin_training.fit_garment.recipe import STEPS_A_SECOND, in_a_hurry
from physkin_training.time_budget import TimeBudget
from physkin_training.train.trainer import Trainer

__all__ = ["ADVICE", "FEWEST_STEPS", "plan_steps", "seconds_for_training"]

log = logging.getLogger(__name__)
REST, LONGEST_REST = 0.25, 150.0
"""Time kept for export and report: share of all, and seconds at most. The report draws and measures less where that is
too little."""
MEASURING = 0.1
"""Share of the time in which steps are timed."""
FEWEST_SECONDS = 10.0
"""Of training, where a length is advised."""
FEWEST_STEPS = 100
"""Shorter runs do not even get through the warm-up."""
ADVICE = "give more, or a smaller recipe with --recipe"


def seconds_for_training(budget: TimeBudget, after: float) -> float:
    """What is left of the budget for training. after: [s] kept for what follows it beside export and report."""
    return budget.left - min(REST * budget.seconds, LONGEST_REST) - after


def plan_steps(trainer: Trainer, budget: TimeBudget, *, after: float = 0.0) -> None:
    """Set the steps of a trainer's run to as many as there is time for: its first ones are timed. A command in a hurry
    times none: it plans for `STEPS_A_SECOND`, and training leaves out what there is no time for.

    after: as of `seconds_for_training`. Raises ValueError when there are too few to learn anything.
    """
    seconds, minutes = seconds_for_training(budget, after), f"{budget.seconds / 60:g} minutes in all"
    if in_a_hurry(trainer.device, budget.seconds):
        steps = max(FEWEST_STEPS, int(STEPS_A_SECOND * seconds))
        trainer.set_steps(steps)
        log.info("%.0f s are left for training: %d steps, or as many as that time allows", max(seconds, 0.0), steps)
        return
    if seconds <= 0:
        raise ValueError(
            f"{minutes} are too few: {budget.spent:.0f} s went by before training, and "
            f"{budget.left - seconds:.0f} s are kept for {'sway, ' if after else ''}export and report: {ADVICE}, of "
            f"--minutes about {math.ceil((budget.spent + FEWEST_SECONDS + after) / (1 - REST) / 60)}"
        )
    try:
        rate = trainer.choose_steps(seconds)
    except ValueError as error:
        raise ValueError(f"{minutes} leave {seconds:.0f} s for training, and {error}: {ADVICE}") from error
    steps = trainer.config.optimisation.steps
    if steps < FEWEST_STEPS:
        missing = (FEWEST_STEPS - steps) / rate / (1 - REST - MEASURING)
        raise ValueError(
            f"{minutes} are only {steps} steps of {1 / rate:.2f} s here, at least {FEWEST_STEPS} are needed: {ADVICE}, "
            f"of --minutes about {math.ceil((budget.seconds + missing) / 60)}"
        )
    log.info("%d steps of %.0f ms in %s, export and report included", steps, 1000 / rate, minutes)
