"""Widgets: what is drawn over and beside the figure, with the legend of its colours."""

from __future__ import annotations

from functools import partial

from physkin_core.view.drawing import Drawing
from physkin_core.view.page import Page
from physkin_core.view.scene.heat_map import SKIN_BANDS, STRAIN_BANDS, Bands, as_bytes
from physkin_core.view.scene.scene_state import SceneState

__all__ = ["LookTab"]

HEATS = {"none": None, "edge strain": "strain", "skin that shows": "skin"}
HEAT_HINT = (
    "edge strain: how much longer or shorter than at rest the cloth is; skin that shows: where cloth should cover it"
)
BANDS = {"strain": STRAIN_BANDS, "skin": SKIN_BANDS}


class LookTab:
    """Switches of a drawing, and of the state that computes what they show."""

    def __init__(self, page: Page, state: SceneState, drawing: Drawing) -> None:
        self._state, self._drawing = state, drawing
        switches = drawing.switches
        splats = [("splats", "splats", "in place of the garment that they are of")] if state.has_splats else []
        page.widget("dropdown", "heat map", tuple(HEATS), hint=HEAT_HINT, change=self._change_heat)
        self._legend = page.server.gui.add_html("", visible=False)
        for name, label, hint in (
            ("nodes", "garment nodes", "points that carry the cloth, as bones carry a body"),
            ("wireframe", "wireframe", "the cloth's triangles"),
            ("normals", "normals", "of some of the cloth's vertices"),
            ("own_colours", "avatar's own colours", "by its file's materials, where it has any"),
            *splats,
            ("follow", "camera follows", "the figure stays where you look"),
        ):
            page.widget("checkbox", label, getattr(switches, name), hint=hint, change=partial(self._switch, name))
        page.lamp.cast_shadow = True
        hint = "half as many frames without a graphics card"
        page.widget("checkbox", "shadows", True, hint=hint, change=partial(setattr, page.lamp, "cast_shadow"))
        hint = "a second figure, whose cloth only follows its bones: without the networks"
        page.widget("checkbox", "plain skinning beside", False, hint=hint, change=self._show_plain)

    def _switch(self, name: str, on: bool) -> None:
        setattr(self._drawing.switches, name, on)
        self._state.redraw()

    def _show_plain(self, on: bool) -> None:
        self._state.show_plain = on
        self._state.redraw()

    def _change_heat(self, chosen: str) -> None:
        heat = HEATS[chosen]
        self._legend.visible = heat is not None
        if heat is not None:
            self._legend.content = _legend(BANDS[heat])
        self._switch("heat", heat)


def _legend(bands: Bands) -> str:
    rows = [
        f'<div><span style="display:inline-block;width:1.6em;height:0.8em;margin-right:0.6em;'
        f'background:rgb({", ".join(map(str, as_bytes(colour)))})"></span>{label}</div>'
        for colour, label in zip(bands.colours, bands.labels)
        if colour is not None
    ]
    return f'<div style="padding:0 0.9em 0.4em;font-size:0.8em">{"".join(rows)}</div>'
