"""Services that answer whatever happens: rclpy leaves a client waiting for ever where a callback raises."""

from __future__ import annotations

from collections.abc import Callable

from rcl_interfaces.msg import SetParametersResult
from rclpy.node import Node
from rclpy.service import Service

from physkin_core.file_reading import sentence

__all__ = ["answer_all"]


def answer_all(node: Node) -> None:
    """Let each service that a ROS node has by now, those of rclpy for parameters and transitions, answer every request:
    an error is logged, and the answer says that it did not succeed, and why where it has a field for that."""
    for service in node.services:
        service.callback = _answering(node, service, service.callback)


def _answering(node: Node, service: Service, callback: Callable) -> Callable:
    def answer(request, response):
        try:
            return callback(request, response)
        except Exception as error:
            reason = sentence(f"{service.srv_name} refused: {error}")
            node.get_logger().error(reason, throttle_duration_sec=1.0)
            refused = type(response)()
            if hasattr(refused, "results"):  # one for each parameter, of which none is sure to be set
                refused.results = [SetParametersResult(reason=reason) for _ in request.parameters]
            elif hasattr(refused, "result") and isinstance(refused.result, SetParametersResult):
                refused.result = SetParametersResult(reason=reason)
            return refused

    return answer
