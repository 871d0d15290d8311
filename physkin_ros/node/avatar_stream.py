"""One avatar: its joint states, its orientation, and the garments it wears.

What is worn at the moment is one object, the attire: garments of one outfit, which are draped in one pass, or garments
that do not know each other. A swap makes another one elsewhere and puts it in its place between two messages.
Dimensions: `d` degrees of freedom. Radians, root frame.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from time import monotonic_ns, perf_counter_ns

import numpy as np
from rclpy.clock import Clock, ClockType
from sensor_msgs.msg import JointState, MultiDOFJointState

from physkin_core import BUNDLED_AVATAR, GarmentModel, LimbSeparator
from physkin_ros.joints.joint_naming import load_naming
from physkin_ros.joints.joint_state_wire import JointStateWire
from physkin_ros.joints.joint_states import JointNaming, JointStateError, JointStateReader
from physkin_ros.joints.nearest_names import nearest_names
from physkin_ros.joints.vrm_naming import VRM
from physkin_ros.node.asset_loading import DraperLoader, LoadedDraper, Outfitting
from physkin_ros.node.diagnostics import AvatarStatistics, Health, HealthReporter
from physkin_ros.node.garment_stream import Attire, GarmentStream, WornGarment, passes_of, same_mesh, stream_quality
from physkin_ros.node.orientation_source import OrientationSource
from physkin_ros.node.separated_joint_states import SeparatedJointStates
from physkin_ros.node.settings import AvatarSettings
from physkin_ros.root.garment_gravity import GarmentGravity
from physkin_ros.root.gravity import Felt, gravity_from_tilt, unit_direction
from physkin_ros.root.quaternions import OrientationError
from physkin_ros.root.tf_topics import FollowedTransforms

__all__ = ["AvatarStream"]

WARNING_PERIOD = 1.0  # [s] rejected messages are warned about at most this often
QUEUE = 50  # joint states that may wait while the machine is busy: worked off in milliseconds, none lost
MOST_UNKNOWN = 64
"""Unknown joints are named in the log until there are so many: whoever changes names must not flood it."""
NANOSECONDS = 1_000_000_000
JOINT_STATE_TYPE = "sensor_msgs/msg/JointState"


class AvatarStream:
    """Drapes the garments of one avatar, a joint state at a time. Nothing comes in before `listen`.

    told: what its garments are told beside the pose. active: whether joint states are answered. deadline_ns: from the
    arrival of a joint state to its last cloud, 0 for none. transforms: TF, of all avatars. settings: with the body that
    is worn.
    Raises ValueError for a joint map that cannot be read.
    """

    def __init__(
        self,
        node,
        settings: AvatarSettings,
        loader: DraperLoader,
        transforms: FollowedTransforms,
        *,
        deadline_ns: int = 0,
    ) -> None:
        self.settings, self.deadline_ns, self.active = settings, deadline_ns, False
        self.statistics = AvatarStatistics()
        self.told = GarmentGravity(unit_direction(settings.gravity), settings.sways)
        self._follows = settings.orientation == "joints"
        self._unknown: set[str] = set()
        self._node, self._loader, self._transforms = node, loader, transforms
        self._naming: tuple[JointNaming, tuple[str, ...]] | None = None
        self._attire: Attire | None = None
        self._closed = False
        self._reporter = HealthReporter()
        self._log = node.get_logger()
        self._label = f"{settings.id}: " if settings.id else ""
        self.garments = tuple(
            GarmentStream(node, settings, garment, self._topics(garment)) for garment in settings.garments
        )
        self._separated = None
        if settings.separate_limbs:
            self._separated = SeparatedJointStates(node, f"~/{settings.id}" if settings.id else "~", settings.frame_id)
        self.topic = node.resolve_topic_name(settings.joint_states or self._default_topic("joint_states"))
        self._bone_topic = settings.bone_rotations or self._default_topic("bone_rotations")
        self._orientation = self._timer = None
        self._subscriptions = []

    def listen(self) -> None:
        """Open the topics that come in. Until something is worn, joint states are counted as `not_ready`."""
        node, settings = self._node, self.settings
        # before the joint states: when both have messages waiting, executors serve the older subscription first
        takers = (self.told.add_direction, self._on_effective_gravity, self._on_bad_orientation)
        self._orientation = OrientationSource(node, settings, self._transforms, *takers)
        self._subscriptions = [
            node.create_subscription(JointState, self.topic, self._on_joint_state, raw=True, **stream_quality(QUEUE)),
            node.create_subscription(
                MultiDOFJointState, self._bone_topic, self._on_bone_rotations, **stream_quality(QUEUE)
            ),
        ]
        if settings.cloud_rate:
            clock = Clock(clock_type=ClockType.STEADY_TIME)
            self._timer = node.create_timer(1.0 / settings.cloud_rate, self._on_cloud_time, clock=clock)

    def _default_topic(self, name: str) -> str:
        return f"{self.settings.id}/{name}" if self.settings.id else name

    def _topics(self, garment) -> str:
        return garment.namespace or (f"~/{self.settings.id}/{garment.name}" if self.settings.id else "~")

    @property
    def ready(self) -> bool:
        """Whether there is something to drape."""
        return self._attire is not None

    # Swapping: these run on any thread.

    def dress(
        self,
        *,
        body: tuple[str, str] | None = None,
        models: dict[int, str] | None = None,
        wanted: Callable[[], bool] = lambda: True,
    ) -> list[LoadedDraper]:
        """Put on what the settings say, with another body (mesh and rig file) or other models by garment index.

        What is worn now serves until all is loaded, and stays when this raises ValueError or OSError, or when it is not
        `wanted` any more by then.
        """
        mesh, rig_file = body or (self.settings.body_mesh, self.settings.body_rig)
        garments = list(self.settings.garments)
        for index, model in (models or {}).items():
            garments[index] = replace(garments[index], model=model)
        wanted_garments = [
            Outfitting(
                model=garment.model,
                body_mesh=mesh,
                body_rig=rig_file,
                precision=garment.precision,
                fit=garment.fit,
                normals=garment.normals,
                tucked=garment.tucked,
            )
            for garment in garments
        ]
        if self.settings.outfit and len(garments) > 1:
            loaded = self._loader.load_outfit(wanted_garments, hide=self.settings.hide)
        else:
            loaded = [self._loader.load(each) for each in wanted_garments]
        attire = self._attire_of(loaded)
        if self._closed or not wanted():  # the body went meanwhile
            return loaded
        if previous := self._attire:
            _carry_on(previous, attire)
        self.settings = replace(self.settings, body_mesh=mesh, body_rig=rig_file, garments=tuple(garments))
        self._attire = attire  # at once: a message is draped by the old one or by the new one
        known = {worn.stream: worn.revision for worn in previous.garments} if previous else {}
        for worn in attire.garments:
            if known.get(worn.stream) != worn.revision:
                worn.stream.show_mesh(worn.draper, worn.revision)
        told = [warning for each in loaded for warning in each.draper.avatar.warnings]
        for warning in dict.fromkeys([*told, *(attire.separator.warnings if attire.separator else ())]):
            self._log.warning(f"{self._label}{warning}")
        source = mesh if mesh and mesh != str(BUNDLED_AVATAR) else "the bundled avatar"
        for worn in attire.garments:
            self._log.info(
                f"{self._label}{worn.draper.model.name} with {worn.draper.vertex_count} vertices on {source}: "
                f"{self.topic} -> {worn.stream.cloud_publisher.topic_name}"
            )
        return loaded

    def _attire_of(self, loaded: Sequence[LoadedDraper]) -> Attire:
        drapers = [each.draper for each in loaded]
        model, *others = [draper.model for draper in drapers]
        for other in others:
            if other.rig.to_json() != model.rig.to_json():
                raise ValueError(
                    f"garments {model.name!r} and {other.name!r} have different rigs; garments of one avatar share one"
                )
        reader = JointStateReader(
            model.rig.joint_names,
            model.rig.rest,
            naming=self._naming_for(model),
            keep_missing=self.settings.missing_joints == "last",
            on_unknown=self._warn_unknown,
            on_degrees=self._warn_degrees,
        )
        skeleton = "vrm" if self.settings.joint_map == VRM else "rig"
        bones = {"skeleton": skeleton, "on_unknown": self._warn_unknown}
        separator = LimbSeparator(model.rig, drapers[0].avatar) if self.settings.separate_limbs else None
        attire = Attire(reader, model, len(drapers), bool(self.settings.cloud_rate), separator, **bones)
        worn_now = {worn.stream: worn for worn in self._attire.garments} if self._attire else {}
        garments = []
        for stream, draper, each in zip(self.garments, drapers, loaded):
            before = worn_now.get(stream)
            revision = 1 if before is None else before.revision + (not same_mesh(before.draper, draper))
            garments.append(WornGarment(stream, draper, each.at_rest, revision))
        attire.garments = tuple(garments)
        attire.passes = passes_of(attire.garments, attire.draped, self.told)
        return attire

    def _naming_for(self, model: GarmentModel) -> JointNaming:
        if self._naming is None or self._naming[1] != model.rig.joint_names:
            self._naming = load_naming(self.settings.joint_map, model.rig), model.rig.joint_names
        return self._naming[0]

    # The path of a message.

    def _on_joint_state(self, data: bytes) -> None:
        arrived = perf_counter_ns()
        if (attire := self._receiving()) is None:
            return
        wire = attire.wire
        try:
            wire.read(data)
            sec, nanosec = wire.stamp
            self._feel(attire, wire, sec * NANOSECONDS + nanosec)
        except ValueError as error:
            self._reject(attire, error)
            return
        self._answer(attire, sec, nanosec, arrived)

    def _on_bone_rotations(self, message: MultiDOFJointState) -> None:
        arrived = perf_counter_ns()
        if (attire := self._receiving()) is None:
            return
        turns = [(each.rotation.x, each.rotation.y, each.rotation.z, each.rotation.w) for each in message.transforms]
        sec, nanosec = message.header.stamp.sec, message.header.stamp.nanosec
        try:
            attire.bone_rotations.read(message.joint_names, turns, attire.pose)
            self._feel(attire, None, sec * NANOSECONDS + nanosec)
        except ValueError as error:
            self._reject(attire, error)
            return
        self._answer(attire, sec, nanosec, arrived)

    def _receiving(self) -> Attire | None:
        """What is worn, for a message that has come in; None when it cannot be answered yet."""
        self.statistics.received += 1
        if self._attire is None or not self.active:
            self.statistics.not_ready += 1
            return None
        return self._attire

    def _answer(self, attire: Attire, sec: int, nanosec: int, arrived: int) -> None:
        """Drape the pose that has been read, or keep it for the next cloud between poses. arrived: [ns]."""
        if attire.interpolator is not None:
            attire.wire.keep()
            stamp_ns, told = sec * NANOSECONDS + nanosec, self.told
            attire.interpolator.push(attire.pose, told.gravity[:, :4], told.load, stamp_ns, monotonic_ns())
            return
        if self._drape(attire, sec, nanosec):
            attire.wire.keep()
            if self.deadline_ns and perf_counter_ns() - arrived > self.deadline_ns:
                self.statistics.deadline_missed += 1

    def _drape(self, attire: Attire, sec: int, nanosec: int) -> bool:
        change = None
        self.told.begin_frame(sec, nanosec)
        if attire.separator is not None:
            _, change = attire.separator.separate(attire.pose, out=attire.draped)
        for each in attire.passes:
            began = perf_counter_ns()
            try:
                each.step()
                took = perf_counter_ns() - began
                for worn in each.garments:
                    worn.stream.statistics.draped(took)
                    worn.publish(sec, nanosec)  # which drapes splats
            except ValueError as error:
                self._reject(attire, error)
                return False
        if change is not None:
            self.statistics.separate(change)
            self._separated.publish(attire.separator.joint_names, attire.draped, sec, nanosec)
        attire.range.add()
        self.statistics.last_stamp_ns = sec * NANOSECONDS + nanosec
        return True

    def _on_cloud_time(self) -> None:
        attire = self._attire
        if not self.active or attire is None or attire.interpolator is None:
            return
        told = self.told
        gravity, load = np.empty_like(told.gravity[:, :4]), np.empty_like(told.load)
        stamp = attire.interpolator.sample(monotonic_ns(), attire.pose, gravity, load)
        if stamp is not None:
            latest = told.gravity.copy(), told.load.copy()
            told.gravity[:, :4], told.load[:] = gravity, load  # the root's rates are those up to the latest
            told.weigh()
            self._drape(attire, *divmod(stamp, NANOSECONDS))
            told.gravity[:], told.load[:] = latest

    def _reject(self, attire: Attire, error: Exception) -> None:
        np.copyto(attire.pose, attire.reader.positions)
        self.statistics.reject(str(error))
        self._log.warning(f"{self._label}joint state ignored: {error}", throttle_duration_sec=WARNING_PERIOD)

    # Orientation.

    def set_gravity(self, down: Sequence[float]) -> None:
        """Take another direction of gravity (3,), of any length but zero, as of now."""
        self.told.set_direction(unit_direction(down))

    def set_sway(self, sways: Sequence[float]) -> None:
        """Let the cloth of each garment swing as much from now on, 0 to 1."""
        self.told.set_sway(sways)
        if self._orientation is not None:
            self._orientation.set_sway(sways)

    def _on_effective_gravity(self, felt: Felt, stamp_ns: int) -> None:
        self.told.add_felt(felt, stamp_ns, monotonic_ns())

    def _feel(self, attire: Attire, wire: JointStateWire | None, stamp_ns: int) -> None:
        """Set what garments feel with a joint state, or with bone rotations, which have no `wire`."""
        if self.told.take_felt(stamp_ns, monotonic_ns(), attire.learnt_sway):
            return
        if self._follows or self._orientation.fault:
            self.told.take_direction(self._followed_orientation(wire))
        else:
            self.told.take_by_stamp(stamp_ns)

    def _followed_orientation(self, wire: JointStateWire | None) -> np.ndarray | None:
        """Gravity's unit direction (3,) as joints of the root tell it, None where they do not, or TF is at fault."""
        if self._orientation.fault:
            self._on_bad_orientation(self._orientation.fault)
            return None
        if wire is None:  # bones have no root tilt: the last one counts
            return None
        index = wire.selection.index
        roll, pitch = self.settings.orientation_joints
        if roll not in index or pitch not in index:
            missing = roll if roll not in index else pitch
            self._on_bad_orientation(f"the joint state has no joint {missing!r} (parameter orientation_joints)")
            return None
        try:
            return gravity_from_tilt(float(wire.values[index[roll]]), float(wire.values[index[pitch]]))
        except OrientationError as error:
            raise JointStateError(str(error)) from None

    def _on_bad_orientation(self, reason: str) -> None:
        self.statistics.reject_gravity(reason)
        self._log.warning(f"{self._label}gravity message ignored: {reason}", throttle_duration_sec=WARNING_PERIOD)

    def _warn_unknown(self, names: list[str]) -> None:
        passed = self._unknown.union(self.settings.orientation_joints if self._follows else ())
        new = [name for name in names if name not in passed][: MOST_UNKNOWN - len(self._unknown)]
        if not new:
            return
        self._unknown.update(new)
        near = nearest_names(new[0], self._attire.reader.joint_names) if self._attire is not None else ""
        self._log.warning(
            f"{self._label}joints without a counterpart in the rig are ignored: {', '.join(each[:60] for each in new)}"
            + (f"; did you mean {near}?" if near else "")
            + ("; further ones will not be named" if len(self._unknown) >= MOST_UNKNOWN else "")
        )

    def _warn_degrees(self, name: str, value: float) -> None:
        reason = f"joint {name!r} is {value:g} rad; are these degrees?"
        self.statistics.doubt(reason)
        self._log.warning(f"{self._label}{reason} It is draped as it is.", throttle_duration_sec=WARNING_PERIOD)

    # Reports.

    def health(self, now_ns: int) -> list[tuple[WornGarment | None, GarmentStream, Health]]:
        """What each garment's stream wears and how it fares since the last call. now_ns: monotonic."""
        attire = self._attire
        self.statistics.strangers = self._strangers()
        beyond = attire.range.beyond() if attire is not None else []
        found = self._reporter.report(self.statistics, [each.statistics for each in self.garments], beyond, now_ns)
        worn = attire.garments if attire is not None else (None,) * len(self.garments)
        return list(zip(worn, self.garments, found))

    def _strangers(self) -> str:
        publishers = self._node.get_publishers_info_by_topic(self.topic)
        others = sorted(
            f"{each.topic_type} of {each.node_name}" for each in publishers if each.topic_type != JOINT_STATE_TYPE
        )
        return ", ".join(others[:3]) + (f" and {len(others) - 3} more" if len(others) > 3 else "")

    def close(self) -> None:
        """Take all topics down."""
        self.active, self._closed = False, True
        self._attire = None
        if self._timer is not None:
            self._node.destroy_timer(self._timer)
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)
        if self._orientation is not None:
            self._orientation.close()
        if self._separated is not None:
            self._separated.close()
        for garment in self.garments:
            garment.close()


def _carry_on(previous: Attire, attire: Attire) -> None:
    """Keep the last good pose over a swap, where the rig is the same."""
    if previous.reader.joint_names == attire.reader.joint_names:
        np.copyto(attire.reader.positions, previous.reader.positions)
        np.copyto(attire.pose, previous.reader.positions)
