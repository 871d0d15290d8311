"""The services `~/set_body` and `~/set_garment`.

A swap takes from milliseconds to seconds, and rclpy's EventsExecutor cannot answer a service later than its callback
ends. So the services live on a ROS node and a thread of their own, under the drape node's name.
"""

from __future__ import annotations

from collections.abc import Callable
from threading import Thread

from physkin_msgs.srv import SetBody, SetGarment
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node

from physkin_core.file_reading import sentence
from physkin_ros.messages.topics import SET_BODY, SET_GARMENT
from physkin_ros.middleware.spinning import new_executor

__all__ = ["SwapServices"]


class SwapServices:
    """Serves both until closed. set_body, set_garment: fill the response for a request; they may take their time."""

    def __init__(self, node: Node, set_body: Callable, set_garment: Callable) -> None:
        self._executor = new_executor(SingleThreadedExecutor, node.context)
        self._log = node.get_logger()
        self._node = Node(
            f"_{node.get_name()}_swaps",  # hidden, as names that begin with _ are
            context=node.context,
            namespace=node.get_namespace(),
            use_global_arguments=False,
            start_parameter_services=False,
            enable_rosout=False,
        )
        name = node.get_fully_qualified_name()
        self._node.create_service(SetBody, SET_BODY.below(name), set_body)
        self._node.create_service(SetGarment, SET_GARMENT.below(name), set_garment)
        self._executor.add_node(self._node)
        self._closed = False
        self._thread = Thread(target=self._serve, name="physkin-swaps", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Take the services down."""
        self._closed = True
        self._executor.wake()
        self._thread.join(timeout=5.0)
        self._executor.shutdown(timeout_sec=0)
        self._node.destroy_node()

    def _serve(self) -> None:
        while not self._closed and self._node.context.ok():
            try:
                self._executor.spin_once(timeout_sec=1.0)
            except ExternalShutdownException:
                return
            except Exception as error:  # a broken request must not end the service
                if self._node.context.ok() and not self._closed:
                    self._log.error(
                        sentence(f"swap service: {type(error).__name__}: {error}"), throttle_duration_sec=1.0
                    )
