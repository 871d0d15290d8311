"""The style of all HTML pages that commands write."""

from __future__ import annotations

import base64
import html
from pathlib import Path
from string import Template

__all__ = ["COLOURS", "badge", "image", "write_page"]

COLOURS = {"ok": "#2d7a46", "repaired": "#1f6fa8", "warning": "#b36b00", "unsure": "#7a4fa3", "refused": "#b3261e"}
"""Of outcomes."""
PAGE = Template("""<!doctype html><html lang="en"><meta charset="utf-8"><title>$title</title>$head<style>
body { font: 15px/1.45 system-ui, sans-serif; max-width: 1200px; margin: 2em auto; padding: 0 1em; color: #25282c; }
table { border-collapse: collapse; margin: 1em 0; font-size: 13px; }
th, td { border-bottom: 1px solid #d8dade; padding: .35em .7em; text-align: left; vertical-align: top; }
img { max-width: 100%; } h1 { font-size: 1.5em; } h2 { font-size: 1.15em; margin-top: 2em; }
figure { display: inline-block; margin: 0 .4em .6em 0; } figcaption { font-size: .85em; color: #5a5f66; }
.outcome { color: white; border-radius: 4px; padding: .1em .5em; } p.note { color: #5a5f66; }
.worse { color: #b3261e; } .well { color: #2d7a46; }
</style><body><h1>$title</h1>
$body
</body></html>
""")


def write_page(path: Path, title: str, body: str, *, refresh: int = 0) -> None:
    """Write a page, whole or not at all; its title is its heading, too. body: HTML. refresh: seconds after which a
    browser reads it again, 0 for never."""
    head = f'<meta http-equiv="refresh" content="{refresh}">' if refresh else ""
    partial = path.with_suffix(".partial")
    partial.write_text(PAGE.substitute(title=html.escape(title), head=head, body=body), encoding="utf-8")
    partial.replace(path)


def badge(text: str, outcome: str) -> str:
    """A word in the colour of an outcome of a check, HTML."""
    return f'<span class="outcome" style="background:{COLOURS[outcome]}">{html.escape(text)}</span>'


def image(png: bytes, text: str = "") -> str:
    """A picture within the page itself, HTML. text: what it shows, for whoever does not see it."""
    return f'<img src="data:image/png;base64,{base64.b64encode(png).decode()}" alt="{html.escape(text)}">'
