"""The table that `physkin evaluate` prints."""

from __future__ import annotations

from collections.abc import Mapping

from tabulate import tabulate

__all__ = ["dynamics_table", "outfit_table", "remarks", "table", "table_cells"]

LARGEST_LIFT = 0.2
"""Mean rise [m] of the garment above plain skinning from which on it is taken to have left the body."""

COLUMNS = {
    "edge_strain_percent": "edge %",
    "area_strain_percent": "area %",
    "inside_percent": "inside %",
    "inside_worn_percent": "inside worn parts %",
    "skin_seen_percent": "skin seen %",
    "in_itself_percent": "cloth in itself %",
    "within_3mm_percent": "< 3 mm %",
    "max_depth_p999_mm": "depth p99.9 mm",
    "max_depth_mm": "deepest mm",
    "stretch_j": "stretch J",
    "bend_j": "bend J",
    "collision_j": "contact J",
    "gravity_j": "gravity J",
    "jitter_mm": "jitter mm",
    "jitter_ratio": "/ skinning's",
    "snaps_percent": "snaps %",
}
OUTFIT_COLUMNS = {
    "shows_through_percent": "shows through %",
    "skin_shows_percent": "skin shows %",
    "hole_percent": "holes %",
    "added_strain_points": "strain +",
    "added_jitter_ratio": "jitter x",
    "hidden_vertices_percent": "hidden %",
}
SETS = {"uniform": "any pose", "everyday": "everyday", "separated": "everyday, limbs separated"}
ROWS = {
    "skinning": "plain skinning",
    "model": "the model",
    "fewer_influences": "{influences} -> 4 influences",
    "tilted": "the model, tilted roots",
    "model_on_subset": "the model, subset",
    "subspace_minimum": "subspace minimum, subset",
    "minimum": "full-space minimum, subset",
}


def table(scores: Mapping) -> str:
    """The rows of `evaluate_model` as a Markdown table, and below it `remarks`."""
    header, *cells = table_cells(scores)
    return "\n\n".join([tabulate(cells, header, tablefmt="pipe", floatfmt=".3f"), *remarks(scores)])


def table_cells(scores: Mapping) -> list[list]:
    """A header and the rows of `evaluate_model`; figures that a row does not have are None."""
    rows = {label.format(**scores["counts"]): scores[row] for row, label in ROWS.items() if row in scores}
    rows |= _motion_rows(scores.get("motion"))
    made = scores.get("made_to_measure", {})
    made_rows = {label: made[row] for row, label in ROWS.items() if row in made} | _motion_rows(made.get("motion"))
    rows |= {f"{label}, made to measure": figures for label, figures in made_rows.items()}
    for group, sets in scores.get("groups", {}).items():
        rows |= {f"{group}, {SETS[name]}, made to measure": figures for name, figures in sets.items()}
    cells = [[label, *(figures.get(column) for column in COLUMNS)] for label, figures in rows.items()]
    return [["", *COLUMNS.values()], *cells]


def remarks(scores: Mapping) -> list[str]:
    """The energy ratio, the jitter ratio, and a warning when the garment has left the body (strain and contact of such
    a garment look excellent), a line each."""
    lines = []
    if "minimum" in scores:
        ratio, pairs = scores["energy_ratio"], scores["counts"]["minimum_pairs"]
        lines.append(f"Stretch, bend and contact energy, model / full-space minimum: {ratio:.2f} ({pairs} pairs)")
        lines.append(f"Full-space minima converged: {scores['minimum']['converged_percent']:.0f} %")
    if motion := scores.get("motion"):
        of = "{clips} clips, {frames} frames at {rate_hz:g} Hz, {bodies} bodies".format(**motion["counts"])
        lines.append(f"Jitter, model / plain skinning: {motion['jitter_ratio']:.2f} ({of})")
    lift = (scores["model"]["gravity_j"] - scores["skinning"]["gravity_j"]) / scores["weight_n"]
    if lift > LARGEST_LIFT:
        lines.append(
            f"WARNING: the garment lies {lift:.2f} m higher than with plain skinning on average; it may have left the "
            "body, and its other figures then mean nothing. Look at it."
        )
    return lines


def outfit_table(scores: Mapping) -> str:
    """Rows of `evaluate_outfits` as a Markdown table: each outfit, its pairs where it has several, and its clips."""
    cells = []
    for outfit, figures in scores["outfit"].items():
        rows = {outfit: figures}
        if len(figures["pairs"]) > 1:
            rows |= {f"- {pair}": {"shows_through_percent": shows} for pair, shows in figures["pairs"].items()}
        rows |= {f"- in {clip}": counted for clip, counted in figures["clips"].items()}
        cells += [[name, *(row.get(column) for column in OUTFIT_COLUMNS)] for name, row in rows.items()]
    of = "{bodies} bodies, {frames} runs of {run} frames from {clips} clips".format(**scores["counts"])
    return tabulate(cells, ["", *OUTFIT_COLUMNS.values()], tablefmt="pipe", floatfmt=".3f") + f"\n\n{of}"


def dynamics_table(scores: Mapping) -> str:
    """Rows of `evaluate_dynamics` as Markdown: each scene without and with sway; the other figures below."""
    total = scores["dynamic"]
    columns = {"rmse_mm": "distance mm", "moving_rmse_mm": "less at rest mm"}
    cells = []
    for name, row in {"all": total, **scores["scenes"]}.items():
        pairs = [value for column in columns for value in (row["quasi_static"][column], row[column])]
        cells.append([name, row["at_rest_mm"], *pairs, row["added_strain_points"]])
    of_kinds = (f"{column}{of}" for column in columns.values() for of in (", each frame by itself", ", sway"))
    headers = ["scene", "at rest mm", *of_kinds, "strain +"]
    lines = [tabulate(cells, headers, tablefmt="pipe", floatfmt=".2f"), ""]
    ends = {f"swing at {rate} Hz": by_kind for rate, by_kind in total["swings"].items()}
    ends |= {name: total[name] for name in ("stop", "turn") if name in total}
    for what, by_kind in ends.items():
        said = (f"{kind} " + ", ".join(f"{k} {v:.2f}" for k, v in row.items()) for kind, row in by_kind.items())
        lines.append(f"{what}: " + "; ".join(said))
    return "\n".join(lines)


def _motion_rows(motion: Mapping | None) -> dict[str, dict]:
    if not motion:
        return {}
    rows = {"plain skinning, motion": motion["skinning"]}
    for clip, scored in {"motion": motion, **motion["clips"]}.items():
        rows[f"the model, {clip}"] = scored["model"] | {"jitter_ratio": scored["jitter_ratio"]}
    for row in ("model_on_subset", "subspace_minimum", "minimum"):
        if row in motion:
            rows[f"{ROWS[row]} of motion"] = motion[row]
    return rows
