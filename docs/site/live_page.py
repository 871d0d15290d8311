"""MkDocs hook: the page that `physkin export --web --camera` has written to build/walk, live in place of pictures. Its
camera is left out there; a link leads to it. `make docs` writes the page where there is the module for browsers.
"""

from __future__ import annotations

import shutil
from pathlib import Path

__all__ = ["PICTURES", "on_page_markdown", "on_post_build"]

WALK = Path(__file__).parents[2] / "build" / "walk"
PICTURES = {
    "![Three bodies dance: a wool skirt, denim and jersey, a silk dress](wardrobe.webp)": "walk",
    "![The page in Chromium](browser.jpg)": "../walk",
}
"""In docs/README.md and docs/browser.md; the page as seen from there."""
FRAME = """<iframe class="live" src="{0}/index.html?camera=no" title="An avatar that walks"></iframe>
<a href="{0}/index.html">Let your camera move it</a>: pictures stay in your browser."""


def on_page_markdown(markdown: str, page, config, files) -> str:
    """The page's text as the site shows it."""
    for picture, walk in PICTURES.items() if WALK.is_dir() else ():
        markdown = markdown.replace(picture, FRAME.format(walk))
    return markdown


def on_post_build(config) -> None:
    """Copy it into the site."""
    if WALK.is_dir():
        shutil.copytree(WALK, Path(config.site_dir) / "walk", dirs_exist_ok=True)
