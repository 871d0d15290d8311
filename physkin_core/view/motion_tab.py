"""Widgets: which motion, play and pause, its time and speed, how much cloth sways, and wind."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from physkin_core.motion.loading import bundled_motions
from physkin_core.view.page import Page
from physkin_core.view.scene.scene_state import SceneState
from physkin_core.view.uploads import Uploads

__all__ = ["MotionTab"]

STRONGEST_WIND = 10.0
"""[m/s]"""
BY_HAND = "none, posed by hand"
SLOWEST, FASTEST = 0.1, 2.0


class MotionTab:
    """`follow` sets the widgets to the state. motion: what the state was given, a name or a file."""

    def __init__(self, page: Page, state: SceneState, uploads: Uploads, *, motion: str | None) -> None:
        self._page, self._state = page, state
        self._motions: dict[str, str | Path | None] = {BY_HAND: None} | {name: name for name in bundled_motions()}
        chosen = next((label for label, name in self._motions.items() if name == motion), None)
        if chosen is None:
            chosen = Path(motion).name
            self._motions[chosen] = motion
        motions, change = tuple(self._motions), self._change_motion
        self._motion = page.widget("dropdown", "motion", motions, initial_value=chosen, change=change)
        self._play = page.widget("button", "Pause", icon="player-pause", change=self._play_or_pause)
        self._time = page.widget("slider", "time [s]", 0.0, 1.0, 0.01, 0.0, change=self._scrub)
        hint = f"times as fast as it was recorded, {SLOWEST} to {FASTEST}"
        change = partial(setattr, state, "speed")
        page.widget("slider", "speed", SLOWEST, FASTEST, 0.05, 1.0, hint=hint, change=change)
        hint = "how much the cloth lags, swings and settles, 0 to 1"
        page.widget("slider", "sway", 0.0, 1.0, 0.05, state.sway, hint=hint, change=partial(setattr, state, "sway"))
        hint = "along the floor's X axis, in an avatar's back as it stands at first; below 0 in its face"
        strengths = -STRONGEST_WIND, STRONGEST_WIND, 0.5, state.wind
        page.widget("slider", "wind [m/s]", *strengths, hint=hint, change=state.blow)
        hint = "BVH, AMC (send its ASF before it), GLB, FBX, VRMA, SMPL's NPZ, a bag's .mcap or .db3 file"
        uploads.add_button("Load a motion", hint=hint, load=self._load)
        self.follow()

    def follow(self) -> None:
        """Show the state's time, and whether it plays."""
        state = self._state
        there = state.motion is not None
        self._play.disabled = self._time.disabled = not there
        self._play.label = "Pause" if state.playing else "Play"
        self._play.icon = "player-pause" if state.playing else "player-play"
        duration = max(round(state.duration, 2), 0.01)
        if self._time.max != duration:
            self._time.value = 0.0
            self._time.max = duration
        self._time.value = min(round(state.seconds, 2), duration) if there else 0.0

    def _change_motion(self, chosen: str) -> None:
        motion = self._motions[chosen]
        self._state.choose_motion(motion)
        if motion is not None:
            self._state.play()
        self.follow()

    def _play_or_pause(self, _) -> None:
        if self._state.playing:
            self._state.pause()
        else:
            self._state.play()
        self.follow()

    def _scrub(self, seconds: float) -> None:
        self._state.pause()
        self._state.scrub(seconds)

    def _load(self, path: Path) -> None:
        with self._page.busy(f"Reading {path.name}"):
            self._state.choose_motion(path)
        self._motions[path.name] = path
        self._motion.options = tuple(self._motions)
        self._motion.value = path.name
        self._state.play()
        self.follow()
