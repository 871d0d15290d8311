"""The documents: their links lead somewhere, and the files that the architecture names are there."""

import re

import pytest
from documents import DOCUMENTS, name_of

from import_graph import PACKAGES, ROOT


def anchors(text):
    """Of the headings of a document, as GitHub makes them."""
    headings = re.findall(r"^#+ (.*)$", text, flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("document", DOCUMENTS, ids=name_of)
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


def test_every_page_is_in_the_index():
    """The notebook, too, which the site's navigation leaves out."""
    text = (ROOT / "docs" / "README.md").read_text()
    pages = {path.relative_to(ROOT / "docs").as_posix() for path in (ROOT / "docs").rglob("*.md")} - {"README.md"}
    assert pages - set(re.findall(r"\]\(([^)#]+)", text)) == set()


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
