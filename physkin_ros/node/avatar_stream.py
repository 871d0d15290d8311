"""One avatar: joint states in, clouds of the garments that it wears out.

What is worn at the moment is one object. A swap makes another one elsewhere and puts it in its place between two
messages. Radians, root frame.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Sequence
from time import monotonic_ns, perf_counter_ns

import numpy as np
from geometry_msgs.msg import Vector3Stamped
from rclpy.clock import Clock, ClockType
from sensor_msgs.msg import JointState, MultiDOFJointState

from physkin_core import BUNDLED_AVATAR, FrameInput
from physkin_core.file_reading import sentence, shown
from physkin_core.rig.nearest_names import nearest_names
from physkin_ros.messages.topics import BONE_ROTATIONS, DRAPED_JOINT_STATES, JOINT_STATES, WIND
from physkin_ros.middleware.quality_of_service import FollowingSubscription, stream_quality
from physkin_ros.node.asset_loading import LoadedWear, OutfitLoader
from physkin_ros.node.diagnostics import AvatarStatistics, Health
from physkin_ros.node.garment_stream import GarmentStream
from physkin_ros.node.orientation_source import OrientationSource
from physkin_ros.node.settings import AvatarSettings
from physkin_ros.node.worn_outfit import WornOutfit
from physkin_ros.root.quaternions import vector_of
from physkin_ros.root.root_state import RootState
from physkin_ros.root.tf_topics import FollowedTransforms

__all__ = ["AvatarStream"]

WARNING_PERIOD = 1.0  # [s] rejected messages are warned about at most this often
MOST_UNKNOWN = 64
"""Unknown joints are named in the log until there are so many: whoever changes names must not flood it."""
NANOSECONDS = 1_000_000_000
JOINT_STATE_TYPE = "sensor_msgs/msg/JointState"


class AvatarStream:
    """Drapes the garments of one avatar, a joint state at a time. Nothing comes in before `listen`.

    settings: with the body and garments that are worn. transforms: TF, of all avatars.
    root: what is known of its root, and the input of its frames. active: whether joint states are answered. worn: what
    is worn, None before the first `dress`.
    """

    def __init__(
        self, node, settings: AvatarSettings, loader: OutfitLoader, transforms: FollowedTransforms, *, active: bool
    ) -> None:
        self.settings, self.active = settings, active
        self.statistics = AvatarStatistics()
        self.root = RootState(settings.gravity, FrameInput(len(settings.garments)))
        self.root.frame_input.sway, self.root.frame_input.wind = settings.sways, settings.wind
        self.worn: WornOutfit | None = None
        self.garments = tuple(GarmentStream(node, settings, garment) for garment in settings.garments)
        self._unknown: set[str] = set()
        self._node, self._loader, self._transforms = node, loader, transforms
        self._closed = False
        self._log = node.get_logger()
        self._label = f"{settings.id}: " if settings.id else ""
        self._separated = None
        if settings.separate_limbs:
            self._separated = SeparatedJointStates(node, settings.id, settings.frame_id)
        self._joints_topic, self._bones_topic = (
            f"/humans/bodies/{settings.id}/{topic.name}" if settings.discover else topic.of(settings.id)
            for topic in (JOINT_STATES, BONE_ROTATIONS)
        )
        self.topic = node.resolve_topic_name(self._joints_topic)
        self._orientation = self._timer = None
        self._subscriptions: list[FollowingSubscription] = []

    def listen(self) -> None:
        """Open the topics that come in. Until something is worn, joint states are counted as `not_ready`."""
        node = self._node
        # before the joint states: when both have messages waiting, executors serve the older subscription first
        self._orientation = OrientationSource(
            node, self.settings, self._transforms, self.root, self._on_bad_orientation
        )
        self._subscriptions = [
            FollowingSubscription(node, Vector3Stamped, WIND.name, self._on_wind),
            FollowingSubscription(
                node, JointState, self._joints_topic, self._on_joint_state, raw=True, on_lost=self._on_lost
            ),
            FollowingSubscription(node, MultiDOFJointState, self._bones_topic, self._on_bone_rotations),
        ]
        if self.settings.cloud_rate:
            clock = Clock(clock_type=ClockType.STEADY_TIME)
            self._timer = node.create_timer(1.0 / self.settings.cloud_rate, self._on_cloud_time, clock=clock)

    # Swapping: this runs on any thread.

    def dress(self, settings: AvatarSettings, wanted: Callable[[], bool] = lambda: True) -> LoadedWear:
        """Put on the body and the garments of these settings.

        What is worn now serves until all is loaded, and stays when this raises ValueError, or when it is not `wanted`
        any more by then.
        """
        if self._closed:
            raise ValueError(f"{self._label}the avatar is not there any more, nothing is loaded for it")
        loaded, previous = self._loader.load(settings), self.worn
        warners = {"on_unknown": self._warn_unknown, "on_degrees": self._warn_degrees}
        now = WornOutfit(settings, loaded, self.garments, self.root.frame_input, previous, **warners)
        if self._closed or not wanted():  # the body went meanwhile
            return loaded
        if previous is not None:
            now.carry_on(previous)
        self.settings = settings
        self.worn = now  # at once: a message is draped by the old one or by the new one
        revisions = {each.stream: each.revision for each in previous.garments} if previous is not None else {}
        for each in now.garments:
            if revisions.get(each.stream) != each.revision:
                each.show_mesh()
        for warning in dict.fromkeys([*loaded.outfit.warnings, *(now.separator.warnings if now.separator else ())]):
            self._log.warning(sentence(f"{self._label}{warning}"))
        source = settings.body_mesh
        source = source if source and source != str(BUNDLED_AVATAR) else "the bundled avatar"
        for each in now.garments:
            what = f"{shown(each.layer.name)} with {each.layer.vertex_count} vertices on {sentence(source)}"
            self._log.info(f"{self._label}{what}: {self.topic} -> {each.stream.cloud_publisher.topic_name}")
        return loaded

    # The path of a message.

    def _on_joint_state(self, data: bytes) -> None:
        if (worn := self._receiving()) is None:
            return
        try:
            worn.wire.read(data)
        except ValueError as error:
            self._reject(error)
            return
        self._answer(worn, *worn.wire.stamp)

    def _on_bone_rotations(self, message: MultiDOFJointState) -> None:
        if (worn := self._receiving()) is None:
            return
        turns = [(each.rotation.x, each.rotation.y, each.rotation.z, each.rotation.w) for each in message.transforms]
        try:
            worn.bone_rotations.read(message.joint_names, turns, worn.received)
        except ValueError as error:
            self._reject(error)
            return
        self._answer(worn, message.header.stamp.sec, message.header.stamp.nanosec)

    def _receiving(self) -> WornOutfit | None:
        """What is worn, for a message that has come in; None when it cannot be answered yet."""
        self.statistics.count("received")
        if self.worn is None or not self.active:
            self.statistics.count("not_ready")
            return None
        return self.worn

    def _answer(self, worn: WornOutfit, sec: int, nanosec: int) -> None:
        """Drape the joint positions that have been received, or keep them for the clouds between two poses.

        `root.take` finds what belongs to this stamp; `begin_frame` then writes it into the rows that `_drape` reads.
        """
        stamp_ns = sec * NANOSECONDS + nanosec
        if self.root.fault and self.root.motion() is None:
            self._on_bad_orientation(self.root.fault)  # and the last direction goes on
        gravity = self.root.take(stamp_ns)
        if worn.interpolator is not None:
            worn.interpolator.push(worn.received, gravity, stamp_ns, monotonic_ns())
            worn.accept_pose()
            return
        self.root.begin_frame(sec, nanosec)
        if self._drape(worn, worn.received, sec, nanosec):
            worn.accept_pose()

    def _on_cloud_time(self) -> None:
        worn = self.worn
        if not self.active or worn is None or (found := worn.interpolator.sample(monotonic_ns())) is None:
            return
        stamp_ns, positions, gravity = found
        sec, nanosec = divmod(stamp_ns, NANOSECONDS)
        self.root.begin_frame(sec, nanosec, gravity)
        self._drape(worn, positions, sec, nanosec)

    def _drape(self, worn: WornOutfit, positions: np.ndarray, sec: int, nanosec: int) -> bool:
        """Drape joint positions in the frame that the root's state has begun, and publish the clouds."""
        try:
            separation = worn.set_pose(positions)
            began = perf_counter_ns()
            worn.step()
            took = perf_counter_ns() - began
            for garment in worn.garments:
                garment.publish(sec, nanosec)  # which drapes splats
        except ValueError as error:
            self._reject(error)
            return False
        self.statistics.draped(sec * NANOSECONDS + nanosec, took, separation)
        if separation is not None:
            self._separated.publish(worn.separator.joint_names, worn.draped, sec, nanosec)
        worn.range.add()
        return True

    def _reject(self, error: Exception) -> None:
        self._ignore("rejected", "joint state", str(error))

    def _on_lost(self, number: int) -> None:
        self.statistics.count("lost", number=number)

    def _ignore(self, count: str, what: str, reason: str) -> None:
        self.statistics.count(count, reason)
        text = f"{self._label}{what} ignored: {self.statistics.last_rejection}"
        self._log.warning(text, throttle_duration_sec=WARNING_PERIOD)

    # Root and wind.

    def _on_wind(self, message: Vector3Stamped) -> None:
        try:
            self.root.frame_input.wind = vector_of(message.vector)
        except ValueError as error:
            self._ignore("wind_rejected", "wind", str(error))

    def _on_bad_orientation(self, reason: str) -> None:
        self._ignore("gravity_rejected", "gravity message", reason)

    # Doubts about names and positions.

    def _warn_unknown(self, names: list[str]) -> None:
        if len(self._unknown) >= MOST_UNKNOWN:
            return
        quoted = {shown(name): name for name in names}
        new = [each for each in quoted if each not in self._unknown][: MOST_UNKNOWN - len(self._unknown)]
        if not new:
            return
        self._unknown.update(new)
        near = nearest_names(quoted[new[0]], self.worn.reader.joint_names) if self.worn is not None else ""
        self._log.warning(
            f"{self._label}joints without a counterpart in the rig are ignored: {', '.join(new)}"
            + (f"; did you mean {near}?" if near else "")
            + ("; further ones will not be named" if len(self._unknown) >= MOST_UNKNOWN else "")
        )

    def _warn_degrees(self, name: str, value: float) -> None:
        reason = f"joint {shown(name)} is {value:g} rad; are these degrees?"
        self.statistics.count("implausible", reason)
        self._log.warning(f"{self._label}{reason} It is draped as it is.", throttle_duration_sec=WARNING_PERIOD)

    # Reports.

    def health(self, now_ns: int) -> Health:
        """How it fares since the last call. now_ns: monotonic."""
        beyond = self.worn.range.beyond() if self.worn is not None else []
        return self.statistics.health(now_ns, beyond, self._strangers(), self._offered())

    def _strangers(self) -> str:
        publishers = self._node.get_publishers_info_by_topic(self.topic)
        others = sorted(
            sentence(f"{each.topic_type} of {each.node_name}")
            for each in publishers
            if each.topic_type != JOINT_STATE_TYPE
        )
        return ", ".join(others[:3]) + (f" and {len(others) - 3} more" if len(others) > 3 else "")

    def _offered(self) -> str:
        """The quality of service of what comes in; the subscriptions follow it."""
        subscriptions = [*self._subscriptions, *(self._orientation.subscriptions if self._orientation else ())]
        offered = {each.topic: each.follow() for each in subscriptions}
        return ", ".join(f"{topic} {quality}" for topic, quality in offered.items() if quality)

    def close(self) -> None:
        """Take all topics down."""
        self.active, self._closed = False, True
        self.worn = None
        if self._timer is not None:
            self._node.destroy_timer(self._timer)
        for each in (*self._subscriptions, *self.garments, self._orientation, self._separated):
            if each is not None:
                each.close()


class SeparatedJointStates:
    """The topic that tells which joint positions an avatar was draped in once its limbs are separated: for whoever
    draws the body. frame_id: of its root."""

    def __init__(self, node, avatar: str, frame_id: str) -> None:
        self._node = node
        self._publisher = node.create_publisher(JointState, DRAPED_JOINT_STATES.of(avatar), **stream_quality())
        self._names: Sequence[str] = ()
        self._message = JointState()
        self._message.header.frame_id = frame_id

    def publish(self, joint_names: Sequence[str], positions: np.ndarray, sec: int, nanosec: int) -> None:
        """Publish positions (d,) [rad] of the rig's joints (d,), with the stamp of the joint state that came in."""
        message = self._message
        if joint_names is not self._names:  # of another rig
            self._names, message.name = joint_names, list(joint_names)
        message.header.stamp.sec, message.header.stamp.nanosec = sec, nanosec
        message.position = array("d", positions.astype(np.float64).tobytes())
        self._publisher.publish(message)

    def close(self) -> None:
        """Take the topic down."""
        self._node.destroy_publisher(self._publisher)
