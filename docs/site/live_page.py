"""MkDocs hook: the page that `physkin export --web` has written to build/walk, live in docs/browser.md in place of its
picture. `make docs` writes it where there is the module for browsers; else the picture stays.
"""

from __future__ import annotations

import shutil
from pathlib import Path

__all__ = ["PICTURE", "on_page_markdown", "on_post_build"]

WALK = Path(__file__).parents[2] / "build" / "walk"
PICTURE = "![The page in Chromium](browser.jpg)"
FRAME = '<iframe class="live" src="../walk/index.html" title="An avatar that walks"></iframe>'


def on_page_markdown(markdown: str, page, config, files) -> str:
    """The page's text as the site shows it."""
    return markdown.replace(PICTURE, FRAME) if WALK.is_dir() else markdown


def on_post_build(config) -> None:
    """Copy it into the site."""
    if WALK.is_dir():
        shutil.copytree(WALK, Path(config.site_dir) / "walk", dirs_exist_ok=True)
