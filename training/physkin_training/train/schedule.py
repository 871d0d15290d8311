"""What changes over a run (paper: Training): pose range, contact, learning rates, influences a vertex, body points."""

from __future__ import annotations

import math
from dataclasses import dataclass

from physkin_core.model.hyper_modulator import POINT_COUNT
from physkin_training.config import TrainingConfig
from physkin_training.sampling.pose_sampling import pose_range
from physkin_training.train.validation import BestModel

__all__ = ["EARLY_REACH", "LATE_REACH", "Schedule", "is_stuck", "last_part"]

EARLY_REACH = 0.1
"""How far [m] bodies are looked for while the pose range grows: heavy ones start that deep in the garment."""
LATE_REACH = 0.05
"""How far [m] afterwards."""
INITIAL_CONTACT = 0.1
"""Share of the material's contact stiffness at the start of the run."""
FEELS_ITSELF = 0.5, 0.7
"""Shares of the steps from which on cloth feels itself, and after which it does so in full: at the beginning it is
crumpled, and would stay so."""
FINAL_RATE = 0.005
"""Share of the learning rates that is left at the end of the run."""
LAST_PART_FROM = 0.6
"""Share of the steps from which a run that has patience may end. One that is stuck before, as it is where few poses a
step are much noise, goes on there, at learning rates that fall from a third."""
AVERAGE_DECAY = 0.999
"""Decay a step of the moving average of networks and skinning weights."""


@dataclass(frozen=True)
class Schedule:
    """One step's place in the run.

    pose_range: share of the joint limits in use. contact: share of the material's contact stiffness, and self_contact:
    of that of cloth with itself. learning_rate: of
    networks, skinning_rate: of skinning weights. average_decay: of the moving average. reach [m]: how far the body is
    looked for. influences, engine_influences: of a vertex, in the first and the second set of skinning weights.
    """

    pose_range: float
    contact: float
    self_contact: float
    learning_rate: float
    skinning_rate: float
    average_decay: float
    influences: int
    engine_influences: int
    encoder_points: int
    reach: float

    @property
    def recorded(self) -> tuple:
        """What a recorded step holds fixed: where it changes, the step is recorded anew."""
        return self.encoder_points, self.reach, self.self_contact > 0

    @classmethod
    def at(cls, step: int, config: TrainingConfig) -> Schedule:
        """The schedule of the step after `step` finished ones."""
        optimisation = config.optimisation
        progress = step / optimisation.steps
        ramp = min(1.0, progress / optimisation.growth) if optimisation.growth > 0 else 1.0
        warm = min(1.0, (progress + 1e-9) / optimisation.warm_up) if optimisation.warm_up > 0 else 1.0
        cosine = 0.5 * (1 + math.cos(math.pi * progress))
        factor = warm * (FINAL_RATE + (1 - FINAL_RATE) * cosine)
        return cls(
            pose_range=pose_range(progress, optimisation.growth),
            contact=INITIAL_CONTACT + (1 - INITIAL_CONTACT) * ramp,
            self_contact=min(max((progress - FEELS_ITSELF[0]) / (FEELS_ITSELF[1] - FEELS_ITSELF[0]), 0.0), 1.0),
            learning_rate=optimisation.learning_rate * factor,
            skinning_rate=optimisation.skinning_rate * factor,
            # A young average forgets faster, so that it does not hold on to the untrained start.
            average_decay=min(AVERAGE_DECAY, (1 + step) / (10 + step)),
            influences=influences_left(progress, config, config.garment_nodes.influences),
            engine_influences=influences_left(progress, config, config.garment_nodes.engine_influences),
            encoder_points=POINT_COUNT if progress >= optimisation.full_encoding else optimisation.encoder_points,
            reach=EARLY_REACH if progress < optimisation.growth else LATE_REACH,
        )


def last_part(config: TrainingConfig) -> int:
    """The step from which a run that has patience may end."""
    return math.ceil(LAST_PART_FROM * config.optimisation.steps)


def is_stuck(step: int, best: BestModel | None, config: TrainingConfig) -> bool:
    """Whether as many measurements as the configuration has patience for have brought none better than the best; once
    the last part has begun, only those in it count."""
    optimisation, last = config.optimisation, last_part(config)
    waited = step - max(best.step if best else step, last if step >= last else 0)
    return bool(optimisation.patience) and waited >= optimisation.patience * optimisation.validate_every


def influences_left(progress: float, config: TrainingConfig, fewest: int) -> int:
    """Influences a vertex at `progress` (0 to 1) of the run: they fall one by one from `prune_from` to `prune_at`."""
    most = config.garment_nodes.initial_influences
    start, end = config.optimisation.prune_from, config.optimisation.prune_at
    if progress < start:
        return most
    if progress >= end:
        return fewest
    return most - math.ceil((most - fewest) * (progress - start) / (end - start))
