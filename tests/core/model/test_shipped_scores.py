"""Figures of the documents that the shipped models' files hold: what is written is what is stored, rounded."""

import re
from pathlib import Path

import pytest

from physkin_core import load_garment_model

ROOT = Path(__file__).parents[3]
GARMENTS = {
    "T-shirt": "tshirt",
    "long sleeve": "longsleeve",
    "trousers": "trousers",
    "skirt": "skirt",
    "dress": "dress",
}
STRAIN = {1: "{edge_strain_percent:.2f}", 2: "{area_strain_percent:.2f}"}
INSIDE, WORN, DEPTH = "{inside_percent:.3f}", "{inside_worn_percent:.3f}", "{max_depth_p999_mm:.0f}"
SKIN, BEND = "{skin_shows_percent:.2f} ({skin_in_sight_percent:.2f})", "{bend_j:.4f}"
EVERYDAY = {5: INSIDE, 6: WORN, 7: DEPTH, 8: SKIN, 11: BEND}
EVERYDAY_PLAIN, EVERYDAY_MODEL = EVERYDAY | STRAIN, EVERYDAY | {9: "{jitter_ratio:.2f}"}
"""Format of the columns that are stored; strain and snaps of the models were measured on more frames."""
UNIFORM = STRAIN | {3: INSIDE, 4: WORN, 5: "{within_3mm_percent:.2f}", 6: DEPTH}


def tables(path):
    """Rows of cells of each table of a document, head and rule left out."""
    found = re.findall(r"(?:^\|.*\n)+", path.read_text(), flags=re.MULTILINE)
    return [[[cell.strip() for cell in line.strip("|").split("|")] for line in text.splitlines()[2:]] for text in found]


def rows_of(table):
    """Garment's scores -> what a row is of -> its cells."""
    garment = None
    for name, *cells in table:
        if name.startswith("**"):
            garment, name = load_garment_model(GARMENTS[name.strip("*")]).scores, "model"
        yield garment, name, cells


def stored(scores, name, *, motion):
    """The figures that a row shows."""
    if name.endswith("made to measure"):
        scores = scores["made_to_measure"]
    scores = scores["motion"] if motion else scores
    return scores["skinning" if name.startswith("plain") else "model"] | {"jitter_ratio": scores.get("jitter_ratio")}


@pytest.mark.parametrize(
    ("number", "model", "plain"), [(0, EVERYDAY_MODEL, EVERYDAY_PLAIN), (1, UNIFORM, UNIFORM)], ids=["motion", "any"]
)
def test_tables_of_shipped_garments(number, model, plain):
    """Each cell whose figure is stored, row by row."""
    table = tables(ROOT / "docs" / "shipped-garments.md")[number]
    assert len(table) == len(GARMENTS) * (3 if number == 0 else 4)
    wrong = []
    for scores, name, cells in rows_of(table):
        figures = stored(scores, name, motion=number == 0)
        columns = plain if name.startswith("plain") else model
        wanted = {column: text.format(**figures) for column, text in columns.items()}
        wrong += [
            (name, column, cells[column - 1], text) for column, text in wanted.items() if cells[column - 1] != text
        ]
    assert wrong == []


def test_table_of_the_readme():
    """Strain in any pose, of the model in one size and of plain skinning."""
    table = next(table for table in tables(ROOT / "README.md") if table[0][0].startswith("T-shirt"))
    for name, *cells in table:
        scores = load_garment_model(GARMENTS[name.split(",")[0]]).scores
        for cell, figures in zip(cells[2:], (scores["model"], scores["skinning"])):
            assert cell == "{edge_strain_percent:.1f} / {area_strain_percent:.1f}".format(**figures), name
