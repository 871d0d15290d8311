"""Figures of the documents that the shipped models' files hold: what is written is what is stored, rounded."""

import re
from pathlib import Path

import pytest

from physkin_core.model.model_file import shipped_models

ROOT = Path(__file__).parents[3]
PAGE, NOTEBOOK = ROOT / "docs" / "shipped-garments.md", ROOT / "docs" / "notebook" / "shipped-garments.md"
STRAIN = "{edge_strain_percent:.2f} / {area_strain_percent:.2f}"
SKIN = "{skin_shows_percent:.2f} ({skin_in_sight_percent:.2f})"
EVERYDAY = ("{inside_percent:.3f}", "{inside_worn_percent:.3f}", "{max_depth_p999_mm:.0f}", SKIN, "{bend_j:.4f}")
UNIFORM = ("{inside_percent:.3f}", "{inside_worn_percent:.3f}", "{within_3mm_percent:.2f}", "{max_depth_p999_mm:.0f}")
"""Of the garment made to measure, behind its strain."""


def tables(path):
    """Rows of cells of each table of a document, head and rule left out."""
    found = re.findall(r"(?:^\|.*\n)+", path.read_text(), flags=re.MULTILINE)
    return [[[cell.strip() for cell in line.strip("|").split("|")] for line in text.splitlines()[2:]] for text in found]


def strains(scores):
    """Cells: made to measure, in one size, and plain skinning in one size."""
    return [STRAIN.format(**rows) for rows in (scores["made_to_measure"]["model"], scores["model"], scores["skinning"])]


def names_described():
    """Of the shipped garments, each in backquotes."""
    return [name for name, *_ in tables(PAGE)[0]]


@pytest.mark.parametrize(("everyday", "formats"), [(True, EVERYDAY), (False, UNIFORM)], ids=["everyday", "uniform"])
def test_tables_of_shipped_garments(everyday, formats, shipped):
    """Every cell of every garment in the notebook."""
    wanted = []
    for name in names_described():
        scores = shipped(name.strip("`")).scores
        if everyday:
            of_motion = {"made_to_measure": scores["made_to_measure"]["motion"]}
            scores = scores["motion"] | of_motion
        measured = scores["made_to_measure"]
        jitter = [f"{measured['jitter_ratio']:.2f}"] if everyday else []
        wanted.append([name, *strains(scores), *(text.format(**measured["model"]) for text in formats), *jitter])
    assert tables(NOTEBOOK)[0 if everyday else 1] == wanted


def test_every_shipped_garment_is_described(shipped):
    """With its number of vertices."""
    rows = tables(PAGE)[0]
    described = {name.strip("`"): vertices for name, *_, vertices in rows}
    assert described == {name: f"{len(shipped(name).garment.vertices):,}" for name in shipped_models()}


def test_table_of_the_readme(shipped):
    """Strain in everyday motion, made to measure and in one size, and in any pose in one size, with plain skinning."""
    rows = next(table for table in tables(ROOT / "README.md") if "vertices" in table[0][0])
    assert len(rows) >= 5
    for name, *cells in rows:
        model = shipped(re.search("`(.+)`", name)[1])
        assert f"{len(model.garment.vertices):,}" in name
        scores = model.scores
        figures = scores["made_to_measure"]["motion"], scores["motion"], scores
        wanted = [each["model"] for each in figures] + [scores["skinning"]]
        assert cells == ["{edge_strain_percent:.1f} / {area_strain_percent:.1f}".format(**each) for each in wanted], (
            name
        )
