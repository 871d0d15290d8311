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
        self._bodies: dict[str, Path] = {BUNDLED: BUNDLED_AVATAR}
        self._rig_files = {state.body: state.rig_file}
        self._layers: list[tuple] = []
        for number in range(1, MOST_LAYERS + 1):
            label = "On the skin" if number == 1 else f"Layer {number}"
            fabrics = (AS_TRAINED, *FABRICS)
            hint = "its hem is under the next one's waistband"
            layer = (
                page.widget("dropdown", label, (NOTHING,), hint="garments, from the skin outwards", change=self._wear),
                page.widget("dropdown", "fabric", fabrics, hint="what it is made of", change=self._wear),
                page.widget("checkbox", "tucked in", False, hint=hint, change=self._wear),
                page.widget("rgb", "colour", (0, 0, 0), change=self._recolour),
            )
            self._layers.append(layer)
        uploads.add_button("Load a garment model", hint="a .safetensors file", load=self._load_model)
        with gui.add_folder("Body"):
            self._body = page.widget("dropdown", "avatar", (BUNDLED,), change=self._change_body)
            skin, hint = as_bytes(state.body_colour), "where it is not shown in its own"
            self._skin = page.widget("rgb", "colour", skin, hint=hint, change=self._recolour)
            hint, change = "move arms and legs out of the trunk and each other", self._change_separation
            self._separate = page.widget("checkbox", "separate limbs", True, hint=hint, change=change)
            hint = "GLB, VRM, FBX, OBJ, PLY or STL; send NAME.rig.json before NAME.obj"
            uploads.add_button("Load a body", hint=hint, load=self._load_body)
        self.show_what_is_worn()

    def show_what_is_worn(self) -> None:
        """Set the widgets to the state, whose files are choices from now on."""
        state = self._state
        for file in (split_fabric(name)[0] for name in state.garments):
            if file not in self._models.values():
                label = Path(file).stem
                self._models[f"{label}, file" if label in self._models else label] = file
        if state.body not in self._bodies.values():
            self._bodies[state.body.name] = state.body
        worn = {name: label for label, name in self._models.items()}
        for layer, (garment, fabric, tucked, colour) in enumerate(self._layers):
            name = state.garments[layer] if layer < len(state.garments) else None
            file, with_fabric = (None, "") if name is None else split_fabric(name)
            garment.options = (NOTHING, *self._models)
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
        self._body.options = tuple(self._bodies)
        self._body.value = next(label for label, path in self._bodies.items() if path == state.body)
        self._separate.value = state.separate_limbs

    def _dress(self, what: str, *garments, **change) -> None:
        """As `SceneState.wear`, which takes a second or two. what: for the notice."""
        try:
            with self._page.busy(what):
                self._state.wear(*garments, **change)
        finally:
            self.show_what_is_worn()
        for warning in self._state.warnings:
            self._page.notice("How it sits", warning, kind="warning")

    def _wear(self, _) -> None:
        chosen = [
            (self._models[garment.value] + ("" if fabric.value == AS_TRAINED else f":{fabric.value}"), tucked.value)
            for garment, fabric, tucked, _ in self._layers
            if garment.value != NOTHING
        ]
        names = [name for name, _ in chosen]
        tucked = [name for name, is_tucked in chosen[:-1] if is_tucked]
        if (tuple(names), frozenset(tucked)) != (self._state.garments, self._state.tucked):
            self._dress("Dressing", names, tucked=tucked)

    def _change_body(self, chosen: str) -> None:
        body = self._bodies[chosen]
        self._dress("Changing the body", body=body, rig_file=self._rig_files.get(body))

    def _change_separation(self, limbs: bool) -> None:
        self._dress("Binding", separate_limbs=limbs)

    def _recolour(self, _) -> None:
        shown = self._layers[: len(self._state.garments)]
        cloth = [_shares(colour.value) for *_, colour in shown]
        self._state.recolour(body=_shares(self._skin.value), cloth=cloth)

    def _load_model(self, path: Path) -> None:
        self._dress(f"Putting on {path.stem}", [*self._state.garments, str(path)], tucked=self._state.tucked)

    def _load_body(self, path: Path) -> None:
        self._dress(f"Reading {path.name}", body=path)


def _shares(colour: tuple[int, ...]) -> tuple[float, ...]:
    return tuple(channel / 255 for channel in colour)
