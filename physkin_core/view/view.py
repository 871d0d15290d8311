"""`physkin view`: show an avatar and its outfit live, on a page in the browser."""

from __future__ import annotations

import argparse
import signal
import sys
import webbrowser
from collections.abc import Sequence
from contextlib import closing
from importlib import import_module

from physkin_core.avatar.loading import BUNDLED_AVATAR
from physkin_core.loader.asset_loader import AssetLoader
from physkin_core.outfit.outfit_options import add_options, print_warnings
from physkin_core.view.garment_files import follow_files
from physkin_core.view.own_meshes import OwnMeshes
from physkin_core.view.page import Page

__all__ = ["begin", "command_parser", "end_at_sigterm", "main"]

WORN = ("trousers", "tshirt")
"""By default, from the skin outwards."""
ROS_PAGE = "physkin_ros.tools.view"
"""What `--ros` needs; imported only then."""


def main(argv: list[str]) -> int:
    """Command line. Returns 0 when the page is ended; errors before there is one are raised."""
    options = command_parser().parse_args(argv)
    if options.ros:
        return import_module(ROS_PAGE).show(options)
    end_at_sigterm()
    made_on = ["--avatar", options.avatar] if options.avatar else []
    made_on += ["--rig", options.rig] if options.rig else []
    made_on += ["--bones", options.bones] if options.bones and options.avatar else []
    with closing(OwnMeshes(options.garment or WORN, made_on)) as own, closing(AssetLoader()) as loader:
        return _show(options, own.garments, loader)


def _show(options: argparse.Namespace, garments: Sequence[str], loader: AssetLoader) -> int:
    from physkin_core.view.scene.scene_state import SceneState
    from physkin_core.view.viewer import Viewer

    motion = None if options.motion == "none" else options.motion
    state = SceneState(
        loader,
        garments,
        tucked=options.tucked,
        body=options.avatar or BUNDLED_AVATAR,
        rig_file=options.rig,
        bones=options.bones,
        motion=motion,
        source_rate_hz=options.source_rate,
        fit=options.fit,
        own_clothes=options.own_clothes,
        points=options.splats,
    )
    print_warnings(state.warnings)
    page = Page(host=options.host, port=options.port)
    viewer = Viewer(page, state, motion=motion)

    def report_change(error: Exception | None) -> None:
        if error is None:
            page.notice("New garments", "A garment file has changed, and is worn.")
        else:
            page.report(error)

    end_following = follow_files(state, report_change)
    try:
        begin(page, browser=not options.no_browser)
        page.run(viewer.tick)
    finally:
        end_following()
        viewer.close()
    return 0


def end_at_sigterm() -> None:
    """End with status 143 at SIGTERM, tidily."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))


def begin(page: Page, *, browser: bool) -> None:
    """Say where the page is, and open it."""
    print(f"physkin view: {page.address} (Ctrl+C ends it)", flush=True)
    if browser:
        webbrowser.open(page.address)


def command_parser() -> argparse.ArgumentParser:
    """The command's options."""
    parser = argparse.ArgumentParser(prog="physkin view", description=__doc__.split("`: ")[1])
    parser.add_argument("avatar", metavar="AVATAR", nargs="?", help="avatar file (default: the bundled one)")
    worn = ", ".join(WORN)
    add_options(parser, "rig", "bones", "source-rate", "own-clothes", "garment", "tucked", "fit", worn=worn)
    parser.add_argument("--motion", default="walk", help="bundled motion, motion file or none (default %(default)s)")
    parser.add_argument(
        "--splats", metavar="PLY", help="Gaussian splats that lie on one of the garments; they are drawn instead of it"
    )
    parser.add_argument("--ros", action="store_true", help="show what a running ROS 2 node publishes")
    parser.add_argument(
        "--host", default="127.0.0.1", help="address to listen at (default: only this machine can open the page)"
    )
    parser.add_argument(
        "--port", type=int, default=8080, help="port of the page, or the next free one (default %(default)s)"
    )
    parser.add_argument("--no-browser", action="store_true", help="print the address of the page without opening it")
    return parser
