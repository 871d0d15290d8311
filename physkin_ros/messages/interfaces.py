"""Whether `physkin_msgs` and `tf2_msgs` are there: clouds, markers and diagnostics depend on neither."""

from __future__ import annotations

__all__ = ["missing_interfaces", "missing_tf"]


def missing_interfaces() -> str:
    """What there is not without `physkin_msgs`, and how to install it; "" where it is installed in this version."""
    try:
        from physkin_msgs.srv import SetBody

        if not hasattr(SetBody.Request, "body_rig"):  # which earlier versions have
            return ""
        state = "of an earlier version"
    except ImportError:
        state = "not installed"
    return (
        f"physkin_msgs is {state}: there are no ~/mesh, ~/garment_nodes, ~/statistics, ~/set_body and ~/set_garment. "
        "To install it, in a clone of PhySkin: python msg_defs/wheel/build.py --install (with colcon: build msg_defs)"
    )


def missing_tf() -> str:
    """What there is not without `tf2_msgs`, and how to install it; "" where it is installed."""
    try:
        from tf2_msgs.msg import TFMessage  # noqa: F401
    except ImportError:
        return (
            "tf2_msgs is not installed: there is no TF, in or out. To install it, in a clone of PhySkin: python "
            "msg_defs/wheel/build.py --install (apt: ros-jazzy-tf2-msgs)"
        )
    return ""
