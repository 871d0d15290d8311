"""The documents: their links lead somewhere, and the files that the architecture names are there."""

import re

import pytest

from import_graph import PACKAGES, ROOT
from physkin_core import load_garment_model

DOCUMENTS = [*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").rglob("*.md"))]


def anchors(text):
    """Of the headings of a document, as GitHub makes them."""
    headings = re.findall(r"^#+ (.*)$", text, flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_links_lead_somewhere(document):
    """To files, and to headings in them."""
    broken = []
    for link in re.findall(r"\]\(([^)]+)\)", document.read_text()):
        if "://" in link:
            continue
        name, _, anchor = link.partition("#")
        target = document.parent / name if name else document
        if not target.exists() or (anchor and anchor not in anchors(target.read_text())):
            broken.append(link)
    assert broken == []


def test_architecture_names_files_that_exist():
    """Python files and folders by their import package, C++ files of native/ by their name."""
    text = (ROOT / "docs" / "architecture.md").read_text()
    names = re.findall(r"`([\w/]+(?:\.(?:py|cpp|hpp)|/))`", text)
    native = {path.name for path in (ROOT / "native").rglob("*.?pp")}

    def exists(name):
        package, _, rest = name.partition("/")
        return name in native or (ROOT / PACKAGES.get(package, package) / rest).exists()

    assert len(names) > 30 and [name for name in names if not exists(name)] == []


def test_readme_stays_short():
    assert len((ROOT / "README.md").read_text().splitlines()) <= 100


def test_table_of_uniform_poses_is_of_the_model_files():
    """Each cell of a garment and its made to measure row is what the model's file holds."""
    text = (ROOT / "docs" / "shipped-garments.md").read_text()
    columns = ["edge_strain_percent", "area_strain_percent", "inside_percent", "inside_worn_percent"]
    columns += ["within_3mm_percent", "max_depth_p999_mm"]
    table = text.split("| uniform poses |")[1].split("\n\n")[0]
    rows = [line.strip("| ").split(" | ") for line in table.splitlines()[2:]]
    kinds = {"": "model", "made to measure": "model", "plain skinning": "skinning"}
    kinds["plain skinning, made to measure"] = "skinning"
    told = 0
    for label, *cells in rows:
        if label.startswith("**"):
            scores = load_garment_model(label.strip("*").lower().replace(" ", "").replace("-", "")).scores
            label = ""
        found = (scores["made_to_measure"] if label.endswith("made to measure") else scores)[kinds[label]]
        for cell, column in zip(cells, columns, strict=True):
            decimals = len(cell.partition(".")[2])
            assert f"{found[column]:.{decimals}f}" == cell, (rows[told][0], column)
        told += 1
    assert told == 20
