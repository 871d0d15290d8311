"""Widgets: a slider for each joint of the rig, within its limits, by part of the body."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from physkin_core.body_shape.limb_chains import find_limbs
from physkin_core.rig.rig import Rig
from physkin_core.view.page import Page
from physkin_core.view.scene.scene_state import SceneState

if TYPE_CHECKING:
    import viser

__all__ = ["PoseTab", "joint_groups"]

STEP = 1.0  # [degrees]
TRUNK, HEAD = "trunk", "head and neck"
ALL = "joints"


class PoseTab:
    """Sliders are in degrees. `follow` sets them to the state. tab: where they are, those of a later rig, too."""

    def __init__(self, page: Page, state: SceneState, tab: viser.GuiTabHandle) -> None:
        self._page, self._state, self._tab = page, state, tab
        with tab:
            hint = "the canonical pose, upright"
            page.widget("button", "Rest pose", icon="rotate", hint=hint, change=lambda _: state.rest())
        self._sliders: dict[int, object] = {}
        self._folders: list = []
        self._shown: tuple = ()
        self._add_sliders()

    def follow(self) -> None:
        """Show the state's pose, unless it is being set by the sliders; other sliders for another rig."""
        state = self._state
        if state.rig.joint_names != self._names:
            for folder in self._folders:
                folder.remove()
            self._add_sliders()
        if state.posed_by_hand or state.playing or state.pose is self._shown:
            return
        self._shown = state.pose
        for joint, slider in self._sliders.items():
            slider.value = float(np.clip(np.degrees(state.pose.positions[joint]), slider.min, slider.max).round(1))

    def _add_sliders(self) -> None:
        rig = self._state.rig
        self._names, self._sliders = rig.joint_names, {}
        positions = np.clip(self._state.pose.positions, rig.lower, rig.upper)
        self._folders = []
        with self._tab:
            for part, joints in joint_groups(rig).items():
                self._folders.append(self._page.server.gui.add_folder(f"{part} [degrees]", expand_by_default=False))
                with self._folders[-1]:
                    for joint in joints:
                        self._add_slider(joint, *np.degrees([rig.lower[joint], rig.upper[joint], positions[joint]]))

    def _add_slider(self, joint: int, lower: float, upper: float, position: float) -> None:
        low, high = float(np.ceil(lower)), float(np.floor(upper))
        start = float(np.clip(round(position), low, high))
        hint = f"{self._names[joint]}: {low:.0f} to {high:.0f} degrees"
        self._sliders[joint] = self._page.widget(
            *("slider", self._names[joint], low, high, STEP, start),
            hint=hint,
            change=lambda degrees: self._state.set_joint(joint, np.radians(degrees)),
        )


def joint_groups(rig: Rig) -> dict[str, list[int]]:
    """Indices of joints by trunk, head, arms and legs; all together for a rig without limbs that can be told."""
    try:
        limbs = find_limbs(rig).limbs
    except ValueError:
        return {ALL: list(range(len(rig.dofs)))}
    groups: dict[str, list[int]] = {name: [] for name in (TRUNK, HEAD, *(limb.name for limb in limbs))}
    for joint, bone in enumerate(rig.dof_bones.tolist()):
        above = rig.ancestors(bone)
        near = [limb.name for limb in limbs if limb.ends[0] in above or bone in rig.ancestors(limb.ends[0])]
        groups[near[0] if len(near) == 1 else TRUNK if near else HEAD].append(joint)
    return {name: joints for name, joints in groups.items() if joints}
