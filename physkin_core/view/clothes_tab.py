"""Widgets: which garments are worn, in which order and colours, on which body."""

from __future__ import annotations

from pathlib import Path

from physkin_core.avatar.loading import BUNDLED_AVATAR
from physkin_core.model.fabric import FABRICS
from physkin_core.model.model_file import shipped_models, split_fabric
from physkin_core.outfit.dressing import MOST_LAYERS
from physkin_core.view.page import Page
from physkin_core.view.scene.heat_map import as_bytes
from physkin_core.view.scene.scene_state import SceneState
from physkin_core.view.uploads import Uploads

__all__ = ["ClothesTab"]

NOTHING = "nothing"
AS_TRAINED = "as trained"
BUNDLED = "bundled avatar"


class ClothesTab:
    """Choices that cannot be worn show as a notice, and the widgets go back to what is worn."""

    def __init__(self, page: Page, state: SceneState, uploads: Uploads) -> None:
        self._page, self._state = page, state
        gui = page.server.gui
        self._models = {name: name for name in shipped_models()}
        files = [split_fabric(name)[0] for name in state.garments]
        self._models |= {Path(name).stem: name for name in files if name not in self._models}
        self._bodies: dict[str, Path] = {BUNDLED: BUNDLED_AVATAR}
        if state.body != BUNDLED_AVATAR:
            self._bodies[state.body.name] = state.body
        self._rig_files = {state.body: state.rig_file}
        self._layers: list[tuple] = []
        for layer in range(MOST_LAYERS):
            label = "On the skin" if layer == 0 else f"Layer {layer + 1}"
            garment = gui.add_dropdown(label, (NOTHING, *self._models), hint="garments, from the skin outwards")
            fabric = gui.add_dropdown("fabric", (AS_TRAINED, *FABRICS), hint="what it is made of")
            tucked = gui.add_checkbox("tucked in", False, hint="its hem is under the next one's waistband")
            colour = gui.add_rgb("colour", (0, 0, 0))
            for widget in (garment, fabric, tucked):
                widget.on_update(page.by_hand(self._wear))
            colour.on_update(page.by_hand(self._recolour))
            self._layers.append((garment, fabric, tucked, colour))
        uploads.add_button("Load a garment model", hint="a .safetensors file", load=self._load_model)
        with gui.add_folder("Body"):
            self._body = gui.add_dropdown("avatar", tuple(self._bodies))
            self._body.on_update(page.by_hand(self._change_body))
            self._skin = gui.add_rgb("colour", as_bytes(state.body_colour), hint="where it is not shown in its own")
            self._skin.on_update(page.by_hand(self._recolour))
            self._separate = gui.add_checkbox(
                "separate limbs", state.separate_limbs, hint="move arms and legs out of the trunk and each other"
            )
            self._separate.on_update(page.by_hand(self._change_separation))
            hint = "GLB, VRM, OBJ, PLY or STL; send NAME.rig.json before NAME.obj"
            uploads.add_button("Load a body", hint=hint, load=self._load_body)
        self.show_what_is_worn()

    def show_what_is_worn(self) -> None:
        """Set the widgets to the state."""
        state, worn = self._state, {name: label for label, name in self._models.items()}
        for layer, (garment, fabric, tucked, colour) in enumerate(self._layers):
            name = state.garments[layer] if layer < len(state.garments) else None
            file, with_fabric = (None, "") if name is None else split_fabric(name)
            garment.value = NOTHING if file is None else worn[file]
            garment.visible = layer <= len(state.garments)
            if with_fabric and with_fabric not in fabric.options:  # numbers, from the command line
                fabric.options = (*fabric.options, with_fabric)
            fabric.value = with_fabric or AS_TRAINED
            fabric.visible = name is not None
            tucked.visible = name is not None and layer + 1 < len(state.garments)
            colour.visible = name is not None
            tucked.value = name in state.tucked
            if name is not None:
                colour.value = as_bytes(state.cloth_colours[layer])
        self._body.value = next(label for label, path in self._bodies.items() if path == state.body)
        self._separate.value = state.separate_limbs

    def _dressing(self, what: str, change) -> None:
        """Something that takes a second or two."""
        try:
            with self._page.busy(what):
                change()
        finally:
            self.show_what_is_worn()
        for warning in self._state.warnings:
            self._page.notice("How it sits", warning, kind="warning")

    def _wear(self) -> None:
        chosen = [
            (self._models[garment.value] + ("" if fabric.value == AS_TRAINED else f":{fabric.value}"), tucked.value)
            for garment, fabric, tucked, _ in self._layers
            if garment.value != NOTHING
        ]
        names = [name for name, _ in chosen]
        tucked = [name for name, is_tucked in chosen[:-1] if is_tucked]
        if (tuple(names), frozenset(tucked)) != (self._state.garments, self._state.tucked):
            self._dressing("Dressing", lambda: self._state.wear(names, tucked=tucked))

    def _change_body(self) -> None:
        body = self._bodies[self._body.value]
        rig_file = self._rig_files.get(body)
        self._dressing("Changing the body", lambda: self._state.put_on(body, rig_file=rig_file))

    def _change_separation(self) -> None:
        self._dressing("Binding", lambda: self._state.separate(self._separate.value))

    def _recolour(self) -> None:
        shown = self._layers[: len(self._state.garments)]
        cloth = [_shares(colour.value) for *_, colour in shown]
        self._state.recolour(body=_shares(self._skin.value), cloth=cloth)

    def _load_model(self, path: Path) -> None:
        worn = [*self._state.garments, str(path)]
        self._models[path.stem] = str(path)
        try:
            self._dressing(f"Putting on {path.stem}", lambda: self._state.wear(worn, tucked=self._state.tucked))
        except Exception:
            del self._models[path.stem]
            raise
        for garment, *_ in self._layers:
            garment.options = (NOTHING, *self._models)

    def _load_body(self, path: Path) -> None:
        before = self._bodies.get(path.name)
        self._bodies[path.name] = path
        self._body.options = tuple(self._bodies)
        try:
            self._dressing(f"Reading {path.name}", lambda: self._state.put_on(path))
        except Exception:
            if before is None:
                del self._bodies[path.name]
                self._body.options = tuple(self._bodies)
                self.show_what_is_worn()
            raise


def _shares(colour: tuple[int, ...]) -> tuple[float, ...]:
    return tuple(channel / 255 for channel in colour)
