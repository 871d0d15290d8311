"""The documents that tests look through."""

from import_graph import ROOT

__all__ = ["DOCUMENTS", "name_of"]

DOCUMENTS = [*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").rglob("*.md"))]


def name_of(document):
    """As tests of one each are told apart."""
    return str(document.relative_to(ROOT))
