"""Draw `docs/scores.svg` from the scores that the shipped models' files hold: python docs/draw_scores.py

Or from what `physkin evaluate --json` wrote, a file a garment: python docs/draw_scores.py mine.json yours.json -o x.svg
Needs the extra `[view]`.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from import_graph import ROOT
from physkin_core import load_garment_model

PLOT = ROOT / "docs" / "scores.svg"
GARMENTS = {
    "tshirt": "T-shirt",
    "longsleeve": "long sleeve",
    "tanktop": "tank top",
    "turtleneck": "turtleneck",
    "hoodie": "hoodie",
    "trousers": "trousers",
    "widetrousers": "wide trousers",
    "shorts": "shorts",
    "skirt": "skirt",
    "circleskirt": "circle skirt",
    "pencilskirt": "pencil skirt",
    "dress": "dress",
    "maxidress": "maxi dress",
    "jumpsuit": "jumpsuit",
}
COLOURS = {"plain skinning": "#c9cdd2", "one size": "#7fb0cf", "made to measure": "#286b94"}


def by_kind(garments: Mapping[str, Mapping], everyday_or_any: str, figure: str) -> list[dict[str, float]]:
    """A figure of each garment by kind of drape. garments: scores by name. everyday_or_any: "motion", or "" for any
    pose."""
    found = []
    for scores in garments.values():
        one_size, measured = scores, scores["made_to_measure"]
        if everyday_or_any:
            one_size, measured = one_size[everyday_or_any], measured[everyday_or_any]
        drapes = zip(COLOURS, (one_size["skinning"], one_size["model"], measured["model"]))
        found.append({kind: figures[figure] for kind, figures in drapes})
    return found


def bars(
    axes: Axes,
    title: str,
    unit: str,
    names: Sequence[str],
    by_garment: list[dict[str, float]],
    colours: dict[str, str],
) -> None:
    """A group of bars a garment."""
    width = 0.8 / len(colours)
    for k, (kind, colour) in enumerate(colours.items()):
        places = np.arange(len(by_garment)) + (k - (len(colours) - 1) / 2) * width
        axes.bar(places, [each[kind] for each in by_garment], 0.9 * width, color=colour, label=kind)
    axes.set_title(title, fontsize=11)
    axes.set_xticks(range(len(by_garment)), [name.replace(" ", "\n") for name in names])
    axes.tick_params(length=0)
    axes.set_ylabel(unit)
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(axis="y", color="#e4e4e4")
    axes.set_axisbelow(True)
    axes.margins(y=0.22)
    axes.legend(frameon=False, fontsize=9)


def main() -> None:
    """Write the plot."""
    parser = argparse.ArgumentParser(description=__doc__.split(":")[0])
    parser.add_argument("scores", nargs="*", type=Path, help="files of evaluate --json (default: the shipped garments)")
    parser.add_argument("-o", "--output", type=Path, default=PLOT)
    options = parser.parse_args()
    garments = {path.stem: json.loads(path.read_text()) for path in options.scores}
    garments = garments or {label: load_garment_model(name).scores for name, label in GARMENTS.items()}
    matplotlib.rcParams |= {"svg.hashsalt": "scores", "font.size": 9, "font.family": "sans-serif"}
    figure, axes = plt.subplots(3, 1, figsize=(11, 8.4), layout="constrained")
    strain, names = "change of edge lengths, %", list(garments)
    any_pose = by_kind(garments, "", "edge_strain_percent")
    bars(axes[0], "every joint anywhere in its range", strain, names, any_pose, COLOURS)
    inside = by_kind(garments, "motion", "inside_percent")
    bars(axes[1], "everyday motion", "inside the body, %", names, inside, COLOURS)
    everyday = by_kind(garments, "motion", "edge_strain_percent")
    bars(axes[2], "everyday motion", strain, names, everyday, COLOURS)
    figure.savefig(options.output, metadata={"Date": None})
    print(f"wrote {options.output}")


if __name__ == "__main__":
    main()
