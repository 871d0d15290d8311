"""The page put together: state, drawing, widgets, read-out, and what a tick of it does."""

from __future__ import annotations

from concurrent.futures import Future
from time import perf_counter

import numpy as np

from physkin_core.view.clothes_tab import ClothesTab
from physkin_core.view.drawing import Drawing
from physkin_core.view.look_tab import LookTab
from physkin_core.view.motion_tab import MotionTab
from physkin_core.view.page import Page, Readout
from physkin_core.view.pose_tab import PoseTab
from physkin_core.view.scene.figures import Contact, figure_process, look_at_contact
from physkin_core.view.scene.scene_state import Frame, SceneState
from physkin_core.view.uploads import Uploads

__all__ = ["Viewer"]

WIDGETS_EVERY, LOOK_EVERY = 0.25, 1.0
"""[s] between two updates of the widgets, and between two looks at contact while something moves."""
STANDS_AFTER = 0.3
"""[s] without a frame."""
SPEED = {
    "draping": "what the garments shown take for one frame, all together: median of 60. Caches go cold between the 30 "
    "frames a second of a page, so that it is two to four times what physkin bench measures",
    "frames a second sent": "of the cloth to the browser, which may draw fewer",
}
FIT = {
    "edge strain": "how much longer or shorter the edges of the cloth's triangles are than at rest, on average",
    "cloth inside the body": "share of the cloth's vertices, and how deep the deepest of them lies",
    "skin that shows": "share of the skin which the garments should cover",
}
"""What the names in the two tables mean."""


class Viewer:
    """Shows a state on a page. motion: what the state was given."""

    def __init__(self, page: Page, state: SceneState, *, motion: str | None) -> None:
        self._page, self._state = page, state
        self._drawing, self._process = Drawing(page), figure_process()
        uploads, gui = Uploads(page), page.server.gui
        self._speed = Readout(page, SPEED)
        tabs = gui.add_tab_group()
        with tabs.add_tab("Motion"):
            self._motion = MotionTab(page, state, uploads, motion=motion)
        with tabs.add_tab("Clothes"):
            self._clothes = ClothesTab(page, state, uploads)
        self._pose = PoseTab(page, state, tabs.add_tab("Pose"))
        with tabs.add_tab("Look"):
            LookTab(page, state, self._drawing)
            self._fit = Readout(page, FIT)
        self._frame: Frame | None = None
        self._contact: Contact | None = None
        self._answer: Future[Contact] | None = None
        self._asked: tuple | None = None
        self._looks = True
        self._widgets_at = self._asked_at = 0.0
        self._drawn, self._moved_at = 0, 0.0

    def tick(self, seconds: float) -> None:
        """Draw what is to be seen after so much more time [s]. An error stops the motion, and is raised."""
        try:
            frame = self._state.advance(seconds)
            if frame is not None:
                self._drawing.show(frame)
                self._frame, self._drawn, self._moved_at = frame, self._drawn + 1, perf_counter()
            elif self._frame is not None and perf_counter() - self._moved_at >= STANDS_AFTER:
                self._drawing.stand(self._frame)
        except Exception:
            self._state.pause()
            raise
        self._look_at_contact()
        now = perf_counter()
        if self._frame is not None and now - self._widgets_at >= WIDGETS_EVERY:
            self._show_widgets(now - self._widgets_at)
            self._widgets_at, self._drawn = now, 0

    def close(self) -> None:
        """End what runs beside the page."""
        self._process.shutdown(wait=False, cancel_futures=True)

    def _look_at_contact(self) -> None:
        """Show what was answered, and ask about the frame drawn last where that has not been asked. After an error
        there are no more such figures."""
        if not self._looks or self._frame is None:
            return
        try:
            if self._answer is not None and self._answer.done():
                answer, self._answer = self._answer, None
                self._show_contact(answer.result())
            asked, now = (self._frame.pose, self._frame.outfit), perf_counter()
            changed = self._asked is None or any(a is not b for a, b in zip(asked, self._asked))
            if changed and self._answer is None and now - self._asked_at >= LOOK_EVERY:
                question = self._drawing.figures.question(self._frame)
                self._answer = self._process.submit(look_at_contact, **question)
                self._asked, self._asked_at = asked, now
        except Exception:
            self._looks, self._contact = False, None
            raise

    def _show_contact(self, found: Contact) -> None:
        if len(found.skin_shows) == len(self._frame.outfit.avatar.faces):  # else of the body before
            self._contact = found
            self._drawing.skin_shows = found.skin_shows
            if self._drawing.switches.heat == "skin":
                self._state.redraw()

    def _show_widgets(self, seconds: float) -> None:
        frame, contact = self._frame, self._contact
        self._motion.follow()
        self._pose.follow()
        names = [layer.name for layer in frame.outfit.layers]
        strains = [float(np.mean(strain)) for strain in self._drawing.figures.strains(frame)]
        worn = "1 garment" if len(names) == 1 else f"{len(names)} garments"
        sent = f"{self._drawn / seconds:.0f}"
        self._speed.show({f"draping, {worn}": f"{frame.microseconds / 1e3:.2f} ms", "frames a second sent": sent})
        rows = {f"edge strain, {name}": f"{strain:.1f} %" for name, strain in zip(names, strains)}
        inside = None if contact is None else f"{contact.inside_percent:.2f} %, {contact.deepest_mm:.0f} mm"
        rows |= {"cloth inside the body": inside}
        rows |= {"skin that shows": None if contact is None else f"{contact.skin_shows_percent:.2f} %"}
        self._fit.show(rows)
