"""One avatar: its joint states, its orientation, and the garments it wears.

What is worn at the moment is one object: an outfit, whose garments are draped in one pass, or several outfits that do
not know each other. A swap makes another one elsewhere and puts it in its place between two messages.
Dimensions: `d` degrees of freedom. Radians, root frame.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from time import monotonic_ns, perf_counter_ns

import numpy as np
from geometry_msgs.msg import Vector3Stamped
from rclpy.clock import Clock, ClockType
from sensor_msgs.msg import JointState, MultiDOFJointState

from physkin_core import BUNDLED_AVATAR, FrameInput, LimbSeparator, Rig
from physkin_core.file_reading import sentence, shown
from physkin_core.sway.frame_input import RootSample
from physkin_ros.joints.joint_naming import load_naming
from physkin_ros.joints.joint_state_wire import JointStateWire
from physkin_ros.joints.joint_states import JointNaming, JointStateError, JointStateReader
from physkin_ros.joints.missing_messages import MissingMessages
from physkin_ros.joints.nearest_names import nearest_names
from physkin_ros.joints.vrm_naming import VRM
from physkin_ros.messages.topics import BONE_ROTATIONS, JOINT_STATES, WIND
from physkin_ros.middleware.quality_of_service import FollowingSubscription
from physkin_ros.node.asset_loading import LoadedLayer, OutfitLoader
from physkin_ros.node.diagnostics import AvatarStatistics, Health, HealthReporter
from physkin_ros.node.garment_stream import (
    GarmentStream,
    LayerMessages,
    WornOutfits,
    passes_of,
    same_mesh,
)
from physkin_ros.node.orientation_source import OrientationSource
from physkin_ros.node.separated_joint_states import SeparatedJointStates
from physkin_ros.node.settings import AvatarSettings
from physkin_ros.root.gravity import EffectiveGravity, gravity_from_tilt
from physkin_ros.root.quaternions import OrientationError, vector_of
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

    root: what is known of its root, and the input of its frames. active: whether joint states are answered.
    deadline_ns: from the arrival of a joint state to its last cloud, 0 for none. transforms: TF, of all avatars.
    settings: with the body that is worn.
    Raises ValueError for a joint map that cannot be read.
    """

    def __init__(
        self,
        node,
        settings: AvatarSettings,
        loader: OutfitLoader,
        transforms: FollowedTransforms,
        *,
        deadline_ns: int = 0,
    ) -> None:
        self.settings, self.deadline_ns, self.active = settings, deadline_ns, False
        self.statistics = AvatarStatistics()
        self.root = RootState(np.array(settings.gravity), FrameInput(len(settings.garments)))
        self.root.frame_input.sway, self.root.frame_input.wind = settings.sways, settings.wind
        self._follows = settings.orientation == "joints"
        self._unknown: set[str] = set()
        self._node, self._loader, self._transforms = node, loader, transforms
        self._naming: tuple[JointNaming, tuple[str, ...]] | None = None
        self._worn: WornOutfits | None = None
        self._closed = False
        self._reporter = HealthReporter()
        self._log = node.get_logger()
        self._label = f"{settings.id}: " if settings.id else ""
        self.garments = tuple(
            GarmentStream(node, settings, garment, self._topics(garment)) for garment in settings.garments
        )
        self._separated = None
        if settings.separate_limbs:
            self._separated = SeparatedJointStates(node, settings.id, settings.frame_id)
        self.topic = node.resolve_topic_name(settings.joint_states or JOINT_STATES.of(settings.id))
        self._bone_topic = settings.bone_rotations or BONE_ROTATIONS.of(settings.id)
        self._orientation = self._timer = None
        self._subscriptions: list[FollowingSubscription] = []
        self._missing = MissingMessages()

    def listen(self) -> None:
        """Open the topics that come in. Until something is worn, joint states are counted as `not_ready`."""
        node, settings = self._node, self.settings
        # before the joint states: when both have messages waiting, executors serve the older subscription first
        takers = (self.root.add_direction, self._on_motion, self._on_bad_orientation)
        self._orientation = OrientationSource(node, settings, self._transforms, *takers)
        self._subscriptions = [
            FollowingSubscription(node, Vector3Stamped, WIND.name, self._on_wind),
            FollowingSubscription(node, JointState, self.topic, self._on_joint_state, raw=True),
            FollowingSubscription(node, MultiDOFJointState, self._bone_topic, self._on_bone_rotations),
        ]
        if settings.cloud_rate:
            clock = Clock(clock_type=ClockType.STEADY_TIME)
            self._timer = node.create_timer(1.0 / settings.cloud_rate, self._on_cloud_time, clock=clock)

    def _topics(self, garment) -> str:
        return garment.namespace or (f"~/{self.settings.id}/{garment.name}" if self.settings.id else "~")

    @property
    def ready(self) -> bool:
        """Whether there is something to drape."""
        return self._worn is not None

    # Swapping: these run on any thread.

    def dress(
        self,
        *,
        body: tuple[str, str] | None = None,
        models: dict[int, str] | None = None,
        wanted: Callable[[], bool] = lambda: True,
    ) -> list[LoadedLayer]:
        """Put on what the settings say, with another body (mesh and rig file) or other models by garment index.

        What is worn now serves until all is loaded, and stays when this raises ValueError, or when it is not `wanted`
        any more by then.
        """
        if self._closed:
            raise ValueError(f"{self._label}the avatar is not there any more, nothing is loaded for it")
        mesh, rig_file = body or (self.settings.body_mesh, self.settings.body_rig)
        garments = list(self.settings.garments)
        for index, model in (models or {}).items():
            garments[index] = replace(garments[index], model=model)
        together = [garments] if self.settings.outfit else [[garment] for garment in garments]
        how = {"hide_covered": self.settings.hide_covered, "limbs": self.settings.separate_limbs}
        loaded = [layer for outfit in together for layer in self._loader.load(outfit, mesh, rig_file, **how)]
        now = self._worn_now(loaded)
        if self._closed or not wanted():  # the body went meanwhile
            return loaded
        if previous := self._worn:
            _carry_on(previous, now)
        self.settings = replace(self.settings, body_mesh=mesh, body_rig=rig_file, garments=tuple(garments))
        self._worn = now  # at once: a message is draped by the old one or by the new one
        known = {worn.stream: worn.revision for worn in previous.garments} if previous else {}
        for worn in now.garments:
            if known.get(worn.stream) != worn.revision:
                worn.stream.show_mesh(worn.outfit, worn.index, worn.revision)
        found = [warning for each in loaded for warning in each.outfit.warnings]
        for warning in dict.fromkeys([*found, *(now.separator.warnings if now.separator else ())]):
            self._log.warning(sentence(f"{self._label}{warning}"))
        source = mesh if mesh and mesh != str(BUNDLED_AVATAR) else "the bundled avatar"
        for worn in now.garments:
            what = f"{shown(worn.layer.name)} with {worn.layer.vertex_count} vertices on {sentence(source)}"
            self._log.info(f"{self._label}{what}: {self.topic} -> {worn.stream.cloud_publisher.topic_name}")
        return loaded

    def _worn_now(self, loaded: Sequence[LoadedLayer]) -> WornOutfits:
        model, *others = [each.layer.model for each in loaded]
        rig = model.rig
        for other in others:
            if other.rig.to_json() != rig.to_json():
                raise ValueError(
                    f"garments {model.name!r} and {other.name!r} have different rigs; garments of one avatar share one"
                )
        reader = JointStateReader(
            rig.joint_names,
            rig.rest,
            naming=self._naming_for(rig),
            keep_missing=self.settings.missing_joints == "last",
            on_unknown=self._warn_unknown,
            on_degrees=self._warn_degrees,
        )
        skeleton = "vrm" if self.settings.joint_map == VRM else "rig"
        bones = {"skeleton": skeleton, "on_unknown": self._warn_unknown}
        limbs = loaded[0].limbs
        separator = None if limbs is None else LimbSeparator.from_bound(limbs)
        now = WornOutfits(reader, rig, len(loaded), bool(self.settings.cloud_rate), separator, **bones)
        worn_before = {worn.stream: worn for worn in self._worn.garments} if self._worn else {}
        garments = []
        for stream, each in zip(self.garments, loaded):
            before = worn_before.get(stream)
            revision = 1 if before is None else before.revision + (not same_mesh(before, each))
            garments.append(LayerMessages(stream, each, revision))
        now.garments = tuple(garments)
        now.passes = passes_of(now.garments, now.draped, self.root.frame_input.rows)
        return now

    def _naming_for(self, rig: Rig) -> JointNaming:
        if self._naming is None or self._naming[1] != rig.joint_names:
            self._naming = load_naming(self.settings.joint_map, rig), rig.joint_names
        return self._naming[0]

    # The path of a message.

    def _on_joint_state(self, data: bytes) -> None:
        arrived = perf_counter_ns()
        if (worn := self._receiving()) is None:
            return
        wire = worn.wire
        try:
            wire.read(data)
            sec, nanosec = wire.stamp
            self._take_root(wire, sec * NANOSECONDS + nanosec)
        except ValueError as error:
            self._reject(worn, error)
            return
        self._answer(worn, sec, nanosec, arrived)

    def _on_bone_rotations(self, message: MultiDOFJointState) -> None:
        arrived = perf_counter_ns()
        if (worn := self._receiving()) is None:
            return
        turns = [(each.rotation.x, each.rotation.y, each.rotation.z, each.rotation.w) for each in message.transforms]
        sec, nanosec = message.header.stamp.sec, message.header.stamp.nanosec
        try:
            worn.bone_rotations.read(message.joint_names, turns, worn.pose)
            self._take_root(None, sec * NANOSECONDS + nanosec)
        except ValueError as error:
            self._reject(worn, error)
            return
        self._answer(worn, sec, nanosec, arrived)

    def _receiving(self) -> WornOutfits | None:
        """What is worn, for a message that has come in; None when it cannot be answered yet."""
        self.statistics.received += 1
        if self._worn is None or not self.active:
            self.statistics.not_ready += 1
            return None
        return self._worn

    def _answer(self, worn: WornOutfits, sec: int, nanosec: int, arrived: int) -> None:
        """Drape the pose that has been read, or keep it for the next cloud between poses. arrived: [ns]."""
        if worn.interpolator is not None:
            worn.wire.keep()
            gravity = self.root.frame_input.rows[:, :3]
            worn.interpolator.push(worn.pose, gravity, sec * NANOSECONDS + nanosec, monotonic_ns())
            return
        if self._drape(worn, sec, nanosec):
            worn.wire.keep()
            if self.deadline_ns and perf_counter_ns() - arrived > self.deadline_ns:
                self.statistics.deadline_missed += 1

    def _drape(self, worn: WornOutfits, sec: int, nanosec: int) -> bool:
        change = None
        self.root.begin_frame(sec, nanosec)
        if worn.separator is not None:
            _, change = worn.separator.separate(worn.pose, out=worn.draped)
        for each in worn.passes:
            began = perf_counter_ns()
            try:
                each.step()
                took = perf_counter_ns() - began
                for garment in each.garments:
                    garment.stream.statistics.draped(took)
                    garment.publish(sec, nanosec)  # which drapes splats
            except ValueError as error:
                self._reject(worn, error)
                return False
        if change is not None:
            self.statistics.separate(change)
            self._separated.publish(worn.separator.joint_names, worn.draped, sec, nanosec)
        worn.range.add()
        self.statistics.last_stamp_ns = sec * NANOSECONDS + nanosec
        return True

    def _on_cloud_time(self) -> None:
        worn = self._worn
        if not self.active or worn is None or worn.interpolator is None:
            return
        rows = self.root.frame_input.rows
        latest = rows.copy()
        stamp = worn.interpolator.sample(monotonic_ns(), worn.pose, rows[:, :3])  # rates are those up to the latest
        if stamp is not None:
            self._drape(worn, *divmod(stamp, NANOSECONDS))
        rows[:] = latest

    def _reject(self, worn: WornOutfits, error: Exception) -> None:
        np.copyto(worn.pose, worn.reader.positions)
        self._missing.pass_over()
        self.statistics.reject(str(error))
        reason = self.statistics.last_rejection
        self._log.warning(f"{self._label}joint state ignored: {reason}", throttle_duration_sec=WARNING_PERIOD)

    # Orientation.

    def set_gravity(self, down: Sequence[float]) -> None:
        """Take another direction of gravity (3,), of any length but zero, as of now."""
        self.root.set_direction(np.array(down))

    def set_wind(self, velocity: Sequence[float]) -> None:
        """Let other wind blow from now on, [m/s] in the world."""
        self.root.frame_input.wind = velocity

    def _on_wind(self, message: Vector3Stamped) -> None:
        try:
            self.set_wind(vector_of(message.vector))
        except ValueError as error:
            self.statistics.reject_wind(str(error))
            reason = self.statistics.last_rejection
            self._log.warning(f"{self._label}wind ignored: {reason}", throttle_duration_sec=WARNING_PERIOD)

    def set_sway(self, sways: Sequence[float]) -> None:
        """Let the cloth of each garment swing as much from now on, 0 to 1."""
        self.root.frame_input.sway = sways

    def _on_motion(self, motion: RootSample | EffectiveGravity, stamp_ns: int) -> None:
        self.root.add_motion(motion, stamp_ns, monotonic_ns())

    def _take_root(self, wire: JointStateWire | None, stamp_ns: int) -> None:
        """Tell garments what goes with a joint state, or with bone rotations, which have no `wire`."""
        now_ns = monotonic_ns()
        self.statistics.missing += self._missing.count(stamp_ns, now_ns)
        if (self._follows or self._orientation.fault) and not self.root.moves(now_ns):
            self._follow_orientation(wire)
        self.root.take(stamp_ns, now_ns)

    def _follow_orientation(self, wire: JointStateWire | None) -> None:
        """Take gravity's direction as joints of the root tell it; where they do not, or TF is at fault, the last one
        goes on."""
        if self._orientation.fault:
            self._on_bad_orientation(self._orientation.fault)
            return
        if wire is None:  # bones have no root tilt
            return
        index = wire.selection.index
        roll, pitch = self.settings.orientation_joints
        if roll not in index or pitch not in index:
            missing = roll if roll not in index else pitch
            self._on_bad_orientation(f"the joint state has no joint {missing!r} (parameter orientation_joints)")
            return
        try:
            self.root.set_direction(
                gravity_from_tilt(float(wire.values[index[roll]]), float(wire.values[index[pitch]]))
            )
        except OrientationError as error:
            raise JointStateError(str(error)) from None

    def _on_bad_orientation(self, reason: str) -> None:
        self.statistics.reject_gravity(reason)
        reason = self.statistics.last_rejection
        self._log.warning(f"{self._label}gravity message ignored: {reason}", throttle_duration_sec=WARNING_PERIOD)

    def _warn_unknown(self, names: list[str]) -> None:
        if len(self._unknown) >= MOST_UNKNOWN:
            return
        expected = self.settings.orientation_joints if self._follows else ()
        quoted = {shown(name): name for name in names if name not in expected}
        new = [each for each in quoted if each not in self._unknown][: MOST_UNKNOWN - len(self._unknown)]
        if not new:
            return
        self._unknown.update(new)
        near = nearest_names(quoted[new[0]], self._worn.reader.joint_names) if self._worn is not None else ""
        self._log.warning(
            f"{self._label}joints without a counterpart in the rig are ignored: {', '.join(new)}"
            + (f"; did you mean {near}?" if near else "")
            + ("; further ones will not be named" if len(self._unknown) >= MOST_UNKNOWN else "")
        )

    def _warn_degrees(self, name: str, value: float) -> None:
        reason = f"joint {shown(name)} is {value:g} rad; are these degrees?"
        self.statistics.doubt(reason)
        self._log.warning(f"{self._label}{reason} It is draped as it is.", throttle_duration_sec=WARNING_PERIOD)

    # Reports.

    def health(self, now_ns: int) -> list[tuple[LayerMessages | None, GarmentStream, Health]]:
        """What each garment's stream wears and how it fares since the last call. now_ns: monotonic."""
        worn = self._worn
        self.statistics.strangers, self.statistics.offered = self._strangers(), self._offered()
        beyond = worn.range.beyond() if worn is not None else []
        found = self._reporter.report(self.statistics, [each.statistics for each in self.garments], beyond, now_ns)
        garments = worn.garments if worn is not None else (None,) * len(self.garments)
        return list(zip(garments, self.garments, found))

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
        self._worn = None
        if self._timer is not None:
            self._node.destroy_timer(self._timer)
        for subscription in self._subscriptions:
            subscription.close()
        if self._orientation is not None:
            self._orientation.close()
        if self._separated is not None:
            self._separated.close()
        for garment in self.garments:
            garment.close()


def _carry_on(previous: WornOutfits, worn: WornOutfits) -> None:
    """Keep the last good pose over a swap, where the rig is the same."""
    if previous.reader.joint_names == worn.reader.joint_names:
        np.copyto(worn.reader.positions, previous.reader.positions)
        np.copyto(worn.pose, previous.reader.positions)
