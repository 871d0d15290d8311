"""The page itself: a server, a floor, notices, a read-out, and a loop that draws until it is interrupted."""

from __future__ import annotations

import contextlib
import functools
import html
import io
import logging
import socket
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from types import MappingProxyType
from typing import Any, Literal

from physkin_core.extras import install_command
from physkin_core.file_reading import sentence
from physkin_core.pictures.picture import PictureError
from physkin_core.view.visitors import only_visitors

__all__ = ["FRAMES_A_SECOND", "Page", "Readout"]

log = logging.getLogger(__name__)

FRAMES_A_SECOND = 30.0
NOTICE_SECONDS = 12.0
LAST_PORT = 65535
NOTICE_COLOURS = {"error": "red", "warning": "yellow", "done": "green"}
BUSY_COLOUR = "blue"
CAMERA, LOOKED_AT = (3.3, 1.5, 1.5), (0.0, 0.0, 0.9)
"""[m] in a world in which the figure stands at the origin and faces X."""
FIELD_OF_VIEW = 0.6  # [rad]
SKY, GROUND, SKY_LIGHT = (255, 255, 255), (150, 145, 140), 2.2
LAMP_PLACE, LAMP_LIGHT = (2.5, 2.0, 4.0), 1.6
"""One sky and one lamp: an environment map costs a browser without a graphics card half of its frames."""
WAITING = "..."


class Page:
    """server: viser's. world, figure: the scene's frames "/world" and "/world/figure". lamp: its light, that may cast
    shadows, which is much work for a browser without a graphics card.

    host, port: where it listens; the next free port where that one is taken. title: of the browser's tab.
    Raises PictureError when viser is not installed, ValueError for an address that is none of this machine's.
    """

    def __init__(self, *, host: str = "127.0.0.1", port: int = 8080, title: str = "PhySkin") -> None:
        try:
            import viser
        except ImportError as error:
            raise PictureError(f"the page needs viser: {install_command('view')}") from error
        _check_address(host, port)
        self._ended = threading.Event()
        box = io.StringIO()  # with the address, which commands print themselves
        with only_visitors(host), contextlib.redirect_stdout(box):
            self.server = viser.ViserServer(host=host, port=port, label=title, verbose=False)
        # any browser could ask viser for a tunnel from the internet, though the button is not shown
        self.server.request_share_url = lambda *_, **__: None
        self.server.gui.configure_theme(
            control_width="medium", show_logo=False, show_share_button=False, brand_color=(41, 107, 148)
        )
        scene = self.server.scene
        scene.set_up_direction("+z")
        camera = self.server.initial_camera
        camera.position, camera.look_at, camera.fov = CAMERA, LOOKED_AT, FIELD_OF_VIEW
        scene.configure_default_lights(enabled=False)
        scene.configure_environment_map(None)
        scene.add_light_hemisphere("/sky", sky_color=SKY, ground_color=GROUND, intensity=SKY_LIGHT)
        self.lamp = scene.add_light_directional("/lamp", intensity=LAMP_LIGHT, position=LAMP_PLACE)
        self.world = scene.add_frame("/world", show_axes=False)
        self.figure = scene.add_frame("/world/figure", show_axes=False)
        scene.add_grid(
            "/world/floor",
            infinite_grid=True,
            cell_size=0.5,
            section_size=1.0,
            cell_color=(225, 225, 225),
            section_color=(200, 200, 200),
            fade_distance=12.0,
        )

    @property
    def address(self) -> str:
        """To open in a browser."""
        return f"http://localhost:{self.server.get_port()}"

    def notice(self, title: str, body: str = "", *, kind: Literal["error", "warning", "done"] = "done") -> None:
        """Tell whoever looks at the page, for some seconds."""
        for client in self.server.get_clients().values():
            client.add_notification(title, body, auto_close_seconds=NOTICE_SECONDS, color=NOTICE_COLOURS[kind])

    @contextlib.contextmanager
    def busy(self, title: str) -> Iterator[None]:
        """A notice that something is being done, while it is."""
        clients = self.server.get_clients().values()
        shown = [client.add_notification(title, "", loading=True, color=BUSY_COLOUR) for client in clients]
        try:
            yield
        finally:
            for each in shown:
                each.remove()

    def guarded(self, callback: Callable[..., None]) -> Callable[..., None]:
        """A callback whose errors show as a notice, and end nothing."""

        @functools.wraps(callback)
        def called(*arguments) -> None:
            try:
                callback(*arguments)
            except Exception as error:  # whatever it is, the page goes on
                self.report(error)

        return called

    def widget(self, kind: str, label: str, *settings, change: Callable[[Any], None], **look):
        """One of viser's widgets, such as a "slider". change: is given the value that a person sets, not what the
        program does; its errors show as notices. settings, look: as viser's `add_slider` takes them."""
        if kind == "slider":
            look["marks"] = ()  # its handle would cover them
        made = getattr(self.server.gui, f"add_{kind}")(label, *settings, **look)

        def changed(event) -> None:
            if event.client_id is not None:
                change(made.value)

        (made.on_click if kind == "button" else made.on_update)(self.guarded(changed))
        return made

    def report(self, error: Exception) -> None:
        """Show an error that was raised: bad input by its sentence, anything else by its kind too, and in the log."""
        expected = isinstance(error, ValueError | OSError | PictureError)
        if not expected:
            log.exception("an error on the page", exc_info=error)
        text = str(error) if expected else f"{type(error).__name__}: {error}"
        self.notice("That did not work", sentence(text), kind="error")

    def run(self, tick: Callable[[float], None]) -> None:
        """Call `tick(seconds since the last call)` thirty times a second until `end`, or an interrupt.

        Its errors are reported, one that comes again and again only once.
        """
        last, reported = time.perf_counter(), ""
        due = last
        try:
            while not self._ended.is_set():
                now = time.perf_counter()
                try:
                    tick(now - last)
                    reported = ""
                except Exception as error:  # whatever it is, the page goes on
                    if repr(error) != reported:
                        reported = repr(error)
                        self.report(error)
                last, due = now, max(due + 1 / FRAMES_A_SECOND, now)
                self._ended.wait(max(0.0, due - time.perf_counter()))
        except KeyboardInterrupt:
            pass
        finally:
            self.server.stop()

    def end(self) -> None:
        """Let `run` return."""
        self._ended.set()


def _check_address(host: str, port: int) -> None:
    """Here, because viser would wait forever for its server."""
    if not 1 <= port <= LAST_PORT:
        raise ValueError(f"port is {port}; allowed: 1 to {LAST_PORT}")
    try:
        family = socket.getaddrinfo(host, None)[0][0]
        socket.create_server((host, 0), family=family).close()
    except OSError as error:
        raise ValueError(
            f"cannot listen at {host}: {error.strerror}; allowed: an address of this machine, as 127.0.0.1, or 0.0.0.0 "
            "for all"
        ) from error


class Readout:
    """A table in the panel. meanings: what its names mean, shown where the mouse rests on one; that of "edge strain" is
    shown on "edge strain, skirt"."""

    def __init__(self, page: Page, meanings: Mapping[str, str] = MappingProxyType({})) -> None:
        self._html = page.server.gui.add_html("")
        self._meanings = {name: html.escape(meaning) for name, meaning in meanings.items()}

    def show(self, rows: Mapping[str, str | None]) -> None:
        """Names and values; None for a value that is not there yet."""
        cells = "".join(
            f'<tr title="{self._meanings.get(name.partition(",")[0], "")}">'
            f'<td style="padding:0 1em 0 0;opacity:0.7">{html.escape(name)}</td>'
            f'<td style="text-align:right">{html.escape(WAITING if value is None else value)}</td></tr>'
            for name, value in rows.items()
        )
        table = f'<table style="width:100%;font-size:0.85em;font-variant-numeric:tabular-nums">{cells}</table>'
        content = f'<div style="padding:0.3em 0.9em 0.6em">{table}</div>'
        if content != self._html.content:
            self._html.content = content
