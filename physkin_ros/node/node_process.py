"""The process of the drape node: `physkin node`, `ros2 run physkin_ros drape_node` and `python -m physkin_ros`."""

from __future__ import annotations

import gc
import logging
import signal
import sys
import traceback
import warnings

import rclpy
from rclpy.exceptions import NameValidationException, ParameterException
from rclpy.executors import ExternalShutdownException
from rclpy.experimental import EventsExecutor
from rclpy.logging import get_logger
from rclpy.utilities import remove_ros_args

from physkin_core import AvatarWarning
from physkin_core.file_reading import sentence
from physkin_ros.messages.topics import TOPICS
from physkin_ros.middleware.spinning import new_executor
from physkin_ros.middleware.transport import use_shipped_profile
from physkin_ros.node.config_file import load_config
from physkin_ros.node.drape_node import DrapeNode
from physkin_ros.node.settings import AVATAR_SETTINGS, GARMENT_SETTINGS, NODE_SETTINGS, SettingsError

__all__ = ["main", "spin"]

NO_PARTICIPANT = "error creating node"  # how rcl says that the middleware refused


def spin(node: DrapeNode) -> None:
    """Serve the node until its context is shut down. What a callback raises is logged, and the next one is served."""
    ok = node.context.ok  # once a message: rclpy.ok() asks for the context first
    try:
        executor = new_executor(EventsExecutor, node.context)
    except ExternalShutdownException:  # a signal came while the node was made
        return
    executor.add_node(node)
    try:
        while ok():  # EventsExecutor delivers nothing in spin(), nor in spin_once() without a timeout
            try:
                executor.spin_once(timeout_sec=1.0)
            except (KeyboardInterrupt, ExternalShutdownException):
                break
            except Exception as error:
                if not ok():  # rclpy's, when a signal ends the context between ok() and the wait
                    break
                what = sentence(f"a message or request could not be handled: {type(error).__name__}: {error}")
                where = "".join(traceback.format_tb(error.__traceback__)[-1:]).strip()
                node.get_logger().error(f"{what} ({where})", throttle_duration_sec=1.0)
    finally:
        executor.remove_node(node)
        executor.shutdown()


def main(argv: list[str] | None = None) -> int:
    """Run the node until SIGINT or SIGTERM. argv: without the program's name. Returns the exit status."""
    arguments = ["drape_node", *(sys.argv[1:] if argv is None else argv)]
    use_shipped_profile()
    node, began = None, False

    def interrupt(signal_number: int, frame: object) -> None:
        """After rclpy's own handler, which ends the context. Raised in a callback it would be logged as a fault."""
        if node is None:
            raise KeyboardInterrupt

    signal.signal(signal.SIGINT, interrupt)
    try:
        arguments = _with_config(arguments)
        _check_assignments(arguments)
        _initialise(arguments)
        began = True
        if unknown := remove_ros_args(arguments)[1:]:
            return _explain_usage(unknown)
        _forward_log()
        node = DrapeNode()
        gc.collect()
        gc.freeze()  # what is there by now stays: looking through it takes 25 ms, while clouds wait
        spin(node)
        return 0
    except KeyboardInterrupt:
        return 0
    except BrokenPipeError:
        raise  # the reader of the usage has gone, which is for the command to know
    except (ValueError, OSError, ImportError, ParameterException, NameValidationException) as error:
        return _refuse(str(error))
    except Exception as error:
        if node is None and str(error).startswith(NO_PARTICIPANT):  # such as DDS security that is not there
            return _refuse(str(error))
        if rclpy.ok() or node is not None or not began:
            raise
        return 0  # a signal came while the node was being made: nothing else ends the context
    finally:
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
        gc.unfreeze()  # or evaluators in reference cycles outlive Python, which nanobind tells on 40 lines


def _refuse(reason: str) -> int:
    print(f"error: {sentence(reason)}", file=sys.stderr)
    return 2


def _with_config(arguments: list[str]) -> list[str]:
    """`--config FILE` as a ROS 2 parameter file, once it is known to be right."""
    if "--config" not in arguments or arguments.index("--config") > (arguments + ["--ros-args"]).index("--ros-args"):
        return arguments
    at = arguments.index("--config")
    if at + 1 >= len(arguments) or arguments[at + 1].startswith("-"):
        raise SettingsError("--config needs a file")
    path = arguments[at + 1]
    load_config(path)
    rest = [*arguments[:at], *arguments[at + 2 :]]
    split = rest.index("--ros-args") if "--ros-args" in rest else len(rest)
    return [*rest[:split], "--ros-args", "--params-file", path, "--", *rest[split:]]


def _check_assignments(arguments: list[str]) -> None:
    """Refuses parameters ahead of `--ros-args`, which rcl would take for the name of a topic and ignore."""
    ours = arguments[: arguments.index("--ros-args")] if "--ros-args" in arguments else arguments
    topics = {topic.name for topic in TOPICS}
    for argument in ours:
        name = argument.partition(":=")[0]
        if name != argument and name in {*NODE_SETTINGS, *AVATAR_SETTINGS, *GARMENT_SETTINGS} - topics:
            raise SettingsError(f"{argument} is a parameter; parameters are given as --ros-args -p {argument}")


def _initialise(arguments: list[str]) -> None:
    """`rclpy.init`; raises ValueError on malformed ROS arguments."""
    try:
        rclpy.init(args=arguments)
    except RuntimeError as error:
        raise ValueError(str(error)) from error


def _explain_usage(arguments: list[str]) -> int:
    """Text of --help; the same after arguments that mean nothing."""
    lines = ["usage: physkin node [--config FILE] [--ros-args -p PARAMETER:=VALUE ... -r TOPIC:=TOPIC ...]", ""]
    lines.append("FILE is a ROS 2 parameter file, for one avatar or for many (avatars.ID.garments.NAME.model).")
    for title, settings in (
        ("node", NODE_SETTINGS),
        ("each avatar", AVATAR_SETTINGS),
        ("each garment", GARMENT_SETTINGS),
    ):
        lines += ["", f"parameters of {title}:"]
        lines += [
            f"  {name:<23} {setting.description} (default {setting.declared!r})" for name, setting in settings.items()
        ]
    lines += ["", "topics and services (with avatars: below ID/, those of a garment below ~/ID/NAME):"]
    for topic in TOPICS:
        needs = f" ({topic.needs})" if topic.needs else ""
        lines.append(f"  {topic.name:<23} {topic.direction}, {topic.type}: {topic.description}{needs}")
    lines += ["", "Ended by SIGKILL the node leaves shared memory (/dev/shm/fastrtps_*) behind: fastdds shm clean."]
    wanted = bool({"-h", "--help"} & set(arguments))
    print("\n".join(lines), file=sys.stdout if wanted else sys.stderr)
    if not wanted:
        print(f"error: unknown arguments: {' '.join(arguments)}", file=sys.stderr)
    return 0 if wanted else 2


def _forward_log() -> None:
    """Send what the core logs, such as the time a body's encoding took, to the ROS log."""
    logger = logging.getLogger("physkin_core")
    logger.setLevel(logging.INFO)
    logger.addHandler(_RosLogHandler())
    warnings.simplefilter("ignore", AvatarWarning)  # the node logs what `Avatar.warnings` holds


class _RosLogHandler(logging.Handler):
    def emit(self, record: logging.LogRecord) -> None:
        # one line a level: rclpy ties each call site to the level of its first message
        if record.levelno >= logging.ERROR:
            get_logger(record.name).error(sentence(record.getMessage()))
        elif record.levelno >= logging.WARNING:
            get_logger(record.name).warning(sentence(record.getMessage()))
        else:
            get_logger(record.name).info(sentence(record.getMessage()))
