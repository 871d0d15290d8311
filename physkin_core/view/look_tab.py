"""Widgets: what is drawn over and beside the figure, with the legend of its colours."""

from __future__ import annotations

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
        gui, switches = page.server.gui, drawing.switches
        splats = [("splats", "splats", "in place of the garment that they are of")] if state.has_splats else []
        self._heat = gui.add_dropdown("heat map", tuple(HEATS), hint=HEAT_HINT)
        self._heat.on_update(page.by_hand(self._change_heat))
        self._legend = gui.add_html("", visible=False)
        for name, label, hint in (
            ("nodes", "garment nodes", "points that carry the cloth, as bones carry a body"),
            ("wireframe", "wireframe", "the cloth's triangles"),
            ("normals", "normals", "of some of the cloth's vertices"),
            ("own_colours", "avatar's own colours", "by its file's materials, where it has any"),
            *splats,
            ("follow", "camera follows", "the figure stays where you look"),
        ):
            box = gui.add_checkbox(label, getattr(switches, name), hint=hint)
            box.on_update(page.by_hand(lambda name=name, box=box: self._switch(name, box.value)))
        page.lamp.cast_shadow = True
        shadows = gui.add_checkbox("shadows", True, hint="half as many frames without a graphics card")
        shadows.on_update(page.by_hand(lambda: setattr(page.lamp, "cast_shadow", shadows.value)))
        plain = gui.add_checkbox(
            "plain skinning beside",
            False,
            hint="a second figure, whose cloth only follows its bones: without the networks",
        )
        plain.on_update(page.by_hand(lambda: self._show_plain(plain.value)))

    def _switch(self, name: str, on: bool) -> None:
        setattr(self._drawing.switches, name, on)
        self._state.redraw()

    def _show_plain(self, on: bool) -> None:
        self._state.show_plain = on
        self._state.redraw()

    def _change_heat(self) -> None:
        heat = HEATS[self._heat.value]
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
