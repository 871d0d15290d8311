"""Whether `physkin_msgs` is there: clouds, markers and diagnostics never depend on our own interfaces."""

from __future__ import annotations

__all__ = ["missing_interfaces"]


def missing_interfaces() -> str:
    """What there is not without `physkin_msgs`, and how to install it; "" where it is installed in this version."""
    try:
        from physkin_msgs.msg import GarmentMesh
        from physkin_msgs.srv import SetBody  # noqa: F401

        if hasattr(GarmentMesh, "visible"):
            return ""
        state = "of an earlier version"
    except ImportError:
        state = "not installed"
    return (
        f"physkin_msgs is {state}: there are no ~/mesh, ~/garment_nodes, ~/statistics, ~/set_body and ~/set_garment. "
        "To install it, in a clone of PhySkin: python msg_defs/wheel/build.py --install (with colcon: build msg_defs)"
    )
