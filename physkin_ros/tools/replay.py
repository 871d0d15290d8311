"""`physkin replay`, with and without ROS: `--live` plays a bag to live topics, all else drapes it without ROS."""

from __future__ import annotations

import argparse
import sys

__all__ = ["command_parser", "main"]


def command_parser() -> argparse.ArgumentParser:
    """Options of `physkin replay` without ROS."""
    from physkin_ros.replay import command

    return command.command_parser()


def main(argv: list[str] | None = None) -> int:
    """Command line. Returns the exit status."""
    arguments = sys.argv[1:] if argv is None else argv
    if "--live" in arguments:
        from physkin_ros.tools.live import main as run
    else:
        from physkin_ros.replay.command import main as run
    return run(arguments)
