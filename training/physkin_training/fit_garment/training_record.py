"""What a training's record and figures say of it: how long it took, its curve, and whether it was long enough."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping
from pathlib import Path

__all__ = ["TrainingRecord", "learnt", "taken_over"]

LAST, STILL_FALLING = 0.25, 2.0
"""Share of the run at its end, and by how many percent the validation energy falls in it where more is worth while."""
FEW_STEPS = 1000
"""Fewer have hardly begun; from some 10,000 on strains are close to those of the shipped garments."""
NO_SWAY = "so that this cloth does not lag or swing when the body moves; physkin learn-sway teaches it on a GPU."
LITTLE_BETTER = 0.7
"""Of plain skinning's edge strain; shipped garments have a quarter to a half of it."""


class TrainingRecord:
    """What a training wrote of itself into `losses.jsonl`, which is `path`; a file that is not there has no rows."""

    def __init__(self, path: Path) -> None:
        self.path = path

    @property
    def _written(self) -> list[dict]:
        return [json.loads(line) for line in self.path.read_text().splitlines()] if self.path.exists() else []

    @property
    def rows(self) -> list[dict]:
        """In order of the steps, without those that were lost and taken again."""
        rows = {row["step"]: row for row in self._written}
        return [rows[step] for step in sorted(rows)]

    @property
    def seconds(self) -> float:
        """How long the run has trained, over all times that it was resumed."""
        rows = self._written
        last = [row["seconds"] for row, after in zip(rows, rows[1:]) if after["seconds"] < row["seconds"]]
        return sum(last) + (rows[-1]["seconds"] if rows else 0.0)

    @property
    def steps(self) -> int:
        """Of the run so far."""
        rows = self.rows
        return rows[-1]["step"] if rows else 0

    def loss_curve(self) -> str:
        """Median stretch and contact energy over the steps as an SVG, logarithmic; a note where there is too little."""
        points = [(row["step"], row["median_stretch_and_collision"]) for row in self.rows]
        points = [(step, energy) for step, energy in points if energy > 0]
        if len(points) < 2:
            return '<p class="note">Too short a run for a curve.</p>'
        from matplotlib.figure import Figure  # takes a second, which would be before the first picture

        figure = Figure(figsize=(8, 2.6), layout="tight")
        axes = figure.subplots()
        axes.semilogy(*zip(*points))
        axes.set(xlabel="step", ylabel="J")
        picture = io.StringIO()
        figure.savefig(picture, format="svg")
        svg = picture.getvalue()
        return (
            "<p>Stretch and contact energy of the median pose. In a run from nothing it rises at first: the range of "
            "poses grows.</p>" + svg[svg.index("<svg") :]
        )

    def longer_or_not(self) -> str:
        """Whether the energy on the validation poses still fell at the end, in words, with the figure: against the
        energy without gravity, which has no zero of its own."""
        measured = [row for row in self.rows if "validation_energy" in row]
        earlier = [row for row in measured if row["step"] <= (1 - LAST) * measured[-1]["step"]]
        if not earlier:
            return "Too short a run to say whether a longer one is worth while."
        before, last = earlier[-1]["validation_energy"], measured[-1]["validation_energy"]
        fell = 100 * (before - last) / measured[-1]["validation_strained"]
        advice = "A longer run is worth while" if fell > STILL_FALLING else "A longer run would gain little"
        return (
            f"{advice}: over the last {100 * LAST:g} % of the steps the energy of the cloth in poses that are only "
            f"measured, not trained on, went from {before:.4f} to {last:.4f} J ({-fell:+.1f} % of what strains it)."
        )

    def undertrained(self, scores: Mapping, *, begun: bool = False) -> str:
        """What is to be said, in plain words, of a model that has not learnt enough to be used; "" of one that has.

        scores: of `evaluate_model`. begun: with another garment's networks.
        """
        model, skinning = (scores[row]["edge_strain_percent"] for row in ("model", "skinning"))
        if (begun or self.steps >= FEW_STEPS) and model <= LITTLE_BETTER * skinning:
            return ""
        return (
            f"After {self.steps:,} steps the edges of the cloth are {model:.1f} % longer or shorter than at rest on "
            f"average, and {skinning:.1f} % where the cloth only follows the bones (plain skinning). A trained garment "
            "has a quarter to a half of that, after some 10,000 steps from nothing. Train it for 15 minutes on a GPU, "
            "or a night or more on a CPU."
        )


def taken_over(training: Mapping, *, sways: bool, own_sway: str = "") -> str:
    """What a run began with, in words. training: of its model. sways: whether that has a sway network. own_sway: how it
    learnt one of its own, in words, "" where it did not try."""
    start = training.get("started_from", {}).get("transferred_from")
    if not start:
        without = f"It has no sway network, {NO_SWAY}"
        return f"Training began with nothing: everything the model knows was learnt on this mesh. {own_sway or without}"
    said = (
        f"Training began with {start}: its garment nodes, which carry the cloth, its networks, which move them by pose "
        "and body, and its folds between the nodes were taken over"
    )
    if sways and not own_sway:
        return f"{said}, and its sway network, by which cloth lags, swings and settles when the body moves."
    return f"{said}. {own_sway or f'{start} has no sway network that could be taken over, {NO_SWAY}'}"


def learnt(training: Mapping, rows: list[dict]) -> str:
    """What a run learnt, in words. training: of its model. rows: of its `losses.jsonl`."""
    begun = "transferred_from" in training.get("started_from", {})
    said = (
        f"{'From there it went on to learn' if begun else 'It learnt from scratch'} the networks, the folds, and how "
        "strongly each node holds each part of your mesh (skinning weights)."
    )
    measured = [(row["validation_energy"], row["step"]) for row in rows if "validation_energy" in row]
    if not measured:
        return said
    energy, step = min(measured)
    first = f" ({measured[0][0]:.4f} J at first)" if len(measured) > 1 else ""
    return (
        f"{said} The model is that of step {step:,}: in poses that are only measured, not trained on, the energy of "
        f"its cloth is the least, {energy:.4f} J{first}."
    )
