"""The pages as a site, and what of them is made from the code: neither is stale."""

import re
import subprocess
import sys
from types import SimpleNamespace

import live_page
import pytest
from source_links import on_page_markdown

import physkin_core
from draw_flow import FLOW, flow
from import_graph import ROOT
from physkin_core import load_garment_model
from ros_reference import REFERENCE, reference

SITE = ROOT / "docs" / "site"


def test_site_builds_without_a_warning(tmp_path):
    """Every link and anchor leads somewhere, the Python reference is filled in; nothing is fetched from elsewhere."""
    pytest.importorskip("mkdocs", reason="needs mkdocs-material: pip install 'physkin[docs]'")
    pytest.importorskip("material", reason="needs mkdocs-material: pip install 'physkin[docs]'")
    pytest.importorskip("mkdocstrings", reason="needs mkdocstrings: pip install 'physkin[docs]'")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "-f", SITE / "mkdocs.yml", "-d", tmp_path]
    run = subprocess.run(command, capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    pages = {path.parent.name for path in tmp_path.rglob("index.html")}
    assert {path.stem for path in (ROOT / "docs").rglob("*.md")} - {"README"} <= pages
    home = (tmp_path / "index.html").read_text()
    assert not re.findall(r'(?:src|href)="https?://(?!squidfunk)[^"]*', home)
    reference = (tmp_path / "api" / "index.html").read_text()
    assert all(f'id="physkin_core.{name}"' in reference for name in physkin_core.__all__)


@pytest.mark.parametrize(
    ("text", "names", "expected"),
    [
        ("Drape. pose: (d,) [rad]. out, kind: as: ever.", ["pose", "out", "kind"], ["pose", "out, kind"]),
        ("faces: (f, 3).\nRaises ValueError for a face: it is bad. A face: no item.", ["faces"], ["faces", "Raises"]),
        ("Nothing to list. name: of a person.", [], []),
    ],
)
def test_docstrings_become_lists(text, names, expected):
    """Of parameters by their names, and of errors."""
    docstring_items = pytest.importorskip("docstring_items", reason="needs griffe: pip install 'physkin[docs]'")
    assert re.findall(r"^- \*\*(.+?)\*\*", docstring_items.listed(text, names), re.MULTILINE) == expected


def test_names_that_share_a_description_become_items_each():
    """If all are parameters or fields, with the lines that belong to them."""
    docstring_items = pytest.importorskip("docstring_items", reason="needs griffe: pip install 'physkin[docs]'")
    text = "Drape.\n\nArgs:\n    time, root: as ever,\n        in metres.\n    out: kept.\n    x, y: no names.\n"
    expected = text.replace(
        "    time, root: as ever,\n        in metres.\n",
        "    time: as ever,\n        in metres.\n    root: as ever,\n        in metres.\n",
    )
    assert docstring_items.one_by_one(text, ["time", "root", "out"]) == expected


@pytest.mark.parametrize(("name", "walk"), [("README.md", "walk"), ("browser.md", "../walk")])
def test_a_live_page_takes_the_place_of_its_picture(tmp_path, monkeypatch, name, walk):
    """Without its camera, and with a link to the one with it, where there is one, and it is copied; else the picture
    stays."""
    text = (ROOT / "docs" / name).read_text()
    monkeypatch.setattr(live_page, "WALK", tmp_path / "walk")
    config = SimpleNamespace(site_dir=tmp_path / "site")
    assert live_page.on_page_markdown(text, None, config, None) == text
    live_page.on_post_build(config)
    (tmp_path / "walk").mkdir()
    (tmp_path / "walk" / "index.html").touch()
    shown = live_page.on_page_markdown(text, None, config, None)
    assert f'src="{walk}/index.html?camera=no"' in shown and f'href="{walk}/index.html"' in shown
    live_page.on_post_build(config)
    assert (tmp_path / "site" / "walk" / "index.html").exists()


@pytest.mark.parametrize(
    ("url", "expected"),
    [
        (None, "see bob and [b](b.md#c)"),
        ("https://x.org/p", "see [bob](https://x.org/p/blob/main/native/b.h) and [b](b.md#c)"),
    ],
)
def test_links_to_sources_leave_the_site(url, expected):
    page = SimpleNamespace(file=SimpleNamespace(src_uri="notebook/a.md"))
    text = "see [bob](../../native/b.h) and [b](b.md#c)"
    assert on_page_markdown(text, page, SimpleNamespace(repo_url=url), None) == expected


def test_ros_reference_is_of_this_code():
    """Else: python docs/ros_reference.py"""
    assert REFERENCE.read_text() == reference()


def test_flow_is_of_the_shipped_model():
    """Else: python docs/draw_flow.py"""
    assert FLOW.read_text() == flow(load_garment_model("tshirt"))


def test_reference_has_what_there_is():
    """Each parameter once, interfaces with every field, also those that share a comment."""
    text = reference()
    for name in ("autostart", "joint_map", "tucked"):
        assert len(re.findall(rf"^\| `{name}`", text, re.MULTILINE)) == 1
    for path in [*(ROOT / "msg_defs").glob("msg/*.msg"), *(ROOT / "msg_defs").glob("srv/*.srv")]:
        declared = [line for line in path.read_text().splitlines() if line and line[0] not in "#-"]
        part = text.split(f"### {path.stem}\n")[1].split("\n### ")[0]
        assert len(re.findall(r"^\| `", part, re.MULTILINE)) == len(declared), path
