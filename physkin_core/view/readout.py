"""What a frame takes, and how well the cloth sits, in numbers."""

from __future__ import annotations

from collections.abc import Mapping

from physkin_core.view.page import Page

__all__ = ["Readout"]

WAITING = "..."


class Readout:
    """A table at the top of the panel."""

    def __init__(self, page: Page) -> None:
        self._html = page.server.gui.add_html("")

    def show(self, rows: Mapping[str, str | None]) -> None:
        """Names and values; None for a value that is not there yet."""
        cells = "".join(
            f'<tr><td style="padding:0 1em 0 0;opacity:0.7">{name}</td>'
            f'<td style="text-align:right">{WAITING if value is None else value}</td></tr>'
            for name, value in rows.items()
        )
        table = f'<table style="width:100%;font-size:0.85em;font-variant-numeric:tabular-nums">{cells}</table>'
        content = f'<div style="padding:0.3em 0.9em">{table}</div>'
        if content != self._html.content:
            self._html.content = content
