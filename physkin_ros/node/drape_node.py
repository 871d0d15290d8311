"""The drape node: joint states in, garment point clouds out, for one or many garments on one or many avatars.

A lifecycle node: configuring loads the files and opens the topics, activating answers joint states. With `autostart`,
the default, both happen at once. The work is done by `AvatarStream`s; here are parameters, transitions and reports.
"""

from __future__ import annotations

import os
import sys
import traceback
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import replace
from functools import partial

from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock, ClockType
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn
from rclpy.parameter import Parameter

from physkin_core.file_reading import sentence
from physkin_core.model.model_file import shipped_models
from physkin_ros.joints.ros4hri import ROS4HRI
from physkin_ros.messages.interfaces import missing_interfaces
from physkin_ros.middleware.answers import answer_all
from physkin_ros.node.asset_loading import AssetRoots, LoadedWear, OutfitLoader
from physkin_ros.node.avatar_stream import AvatarStream
from physkin_ros.node.body_discovery import BodyDiscovery, body_publishers
from physkin_ros.node.orientation_source import check_orientation
from physkin_ros.node.parameters import declare_settings
from physkin_ros.node.reports import Reports
from physkin_ros.node.settings import (
    AvatarSettings,
    NodeSettings,
    SettingsError,
    check_setting,
)
from physkin_ros.node.settings_reading import model_names, read_settings
from physkin_ros.root.tf_topics import FollowedTransforms

__all__ = ["DrapeNode"]

WARNING_PERIOD = 5.0  # [s]
SWITCH_INTERVAL = 0.00002
"""[s] A swap in the background gives the interpreter's lock up so soon after the executor asks for it. A message asks
for it several times; at Python's own 0.005 s, or at a tenth of that, clouds come late by a multiple of the interval."""


class DrapeNode(LifecycleNode):
    """Serves the avatars of its parameters.

    Raises ValueError (models, avatars, rigs, joint maps, parameter values), OSError or ParameterException (parameter
    types); without `autostart`, those of the files only fail the transition `configure`.
    """

    def __init__(self, **arguments) -> None:
        """arguments: as `rclpy.node.Node` takes them, such as `context` and `parameter_overrides`."""
        super().__init__("drape_node", **arguments)
        self._streams: dict[str, AvatarStream] = {}
        self._transforms = FollowedTransforms(self)
        self._discoveries: dict[str, BodyDiscovery] = {}  # by the prefix of the settings that the bodies share
        self._opened = ExitStack()  # what else is there while it is configured
        self._failure: Exception | None = None
        self._starting = False
        self._active = False
        try:
            self._changeable = declare_settings(self)
            self._settings = self._read_settings()
        except BaseException:
            super().destroy_node()
            raise
        self._roots = AssetRoots(
            self._settings.asset_roots,
            (
                file
                for avatar in self._settings.avatars
                for file in (avatar.body_mesh, *(each.file for each in avatar.garments))
                if file not in shipped_models()
            ),
        )
        self._loader = OutfitLoader(seconds=self._settings.load_timeout, memory=self._settings.load_memory_limit)
        self._worker = ThreadPoolExecutor(1, thread_name_prefix="physkin-loader", initializer=_schedule_as_batch)
        answer_all(self)
        self.add_on_set_parameters_callback(self._check_parameters)
        self.add_post_set_parameters_callback(self._follow_parameters)
        sys.setswitchinterval(min(sys.getswitchinterval(), SWITCH_INTERVAL))
        if missing := missing_interfaces():
            self.get_logger().warning(missing)
        if self._settings.autostart:
            self._start()

    # Parameters.

    def _read_settings(self) -> NodeSettings:
        return read_settings({name: parameter.value for name, parameter in self.get_parameters_by_prefix("").items()})

    def _check_parameters(self, parameters: Iterable[Parameter]) -> SetParametersResult:
        worn: dict[str, str] = {}
        for stream in list(self._streams.values()):
            worn |= _parameters_of(stream.settings)
        for parameter in parameters:
            setting = self._changeable.get(parameter.name)
            if setting is None or (parameter.name, parameter.value) in worn.items():  # maybe from its start
                continue
            key = parameter.name.rsplit(".", 1)[-1]
            try:
                value = check_setting(parameter.name, setting, parameter.value)
                if key == "body_mesh":
                    self._roots.check_body(value)
                elif key == "model":
                    self._check_models(parameter.name, value)
            except (ValueError, OSError, RuntimeError) as error:  # the latter for a circle of links
                return SetParametersResult(successful=False, reason=sentence(str(error)))
        return SetParametersResult(successful=True)

    def _check_models(self, name: str, value: str) -> None:
        """Raises ValueError where a parameter `model` names models that may not be worn, or another number of them."""
        models = [value]
        if name == "model":  # of a node without avatars: of all its garments
            models, count = model_names(value), len(self._settings.avatars[0].garments)
            if len(models) != count:
                raise SettingsError(
                    f"parameter model names {len(models)} garments; allowed: {count}, as many as the node started with"
                )
        for model in models:
            if not model:
                raise SettingsError(f"parameter {name} is {value!r}; allowed: models joined by commas")
            self._roots.check_garment(model)

    def _follow_parameters(self, parameters: Iterable[Parameter]) -> None:
        names = {parameter.name for parameter in parameters}
        if not names & self._changeable.keys():
            return
        self._settings = settings = self._read_settings()
        by_prefix = {avatar.prefix: avatar for avatar in settings.avatars}
        for stream in list(self._streams.values()):  # bodies may be found meanwhile, by another thread
            avatar = by_prefix[stream.settings.prefix]  # of bodies that were discovered, their template
            if avatar.prefix + "gravity" in names:
                stream.root.set_direction(avatar.gravity)
            if avatar.prefix + "wind" in names:
                stream.root.frame_input.wind = avatar.wind
            if names & {each.prefix + "sway" for each in (avatar, *avatar.garments)}:
                stream.root.frame_input.sway = avatar.sways
            if self._wish(stream) is not None:
                self._worker.submit(self._grant_wishes, stream)

    def _wish(self, stream: AvatarStream) -> AvatarSettings | None:
        """What the parameters ask of a stream; None when it wears that, or is none of theirs."""
        for avatar in self._settings.avatars:
            if self._streams.get(avatar.id) is stream and not avatar.discover:
                return avatar if avatar.worn != stream.settings.worn else None
        return None

    def _is_wished(self, stream: AvatarStream, wish: AvatarSettings) -> bool:
        now = self._wish(stream)
        return now is not None and now.worn == wish.worn

    def _grant_wishes(self, stream: AvatarStream) -> None:
        """Have a stream wear what the parameters say in the end, though they may change while it loads.

        Runs on the worker. Where that cannot be loaded, the parameters go back to what is worn.
        """
        while (wish := self._wish(stream)) is not None:
            try:
                stream.dress(wish, partial(self._is_wished, stream, wish))
            except Exception as error:
                self._report_swap(stream, error)
                if self._is_wished(stream, wish):
                    self._show_settings(stream)
                    return

    def _show_settings(self, stream: AvatarStream, only: Iterable[str] = ()) -> None:
        """Let the parameters say what is worn. only: full names of those that are meant, by default all."""
        worn, values = stream.settings, _parameters_of(stream.settings)
        changed = [
            Parameter(name, value=value)
            for name, value in values.items()
            if name in (only or values) and name in self._changeable and self.get_parameter(name).value != value
        ]
        if changed and self._streams.get(worn.id) is stream and not worn.discover:
            self.set_parameters_atomically(changed)

    # Lifecycle.

    def _start(self) -> None:
        self._starting = True
        try:
            for trigger in (self.trigger_configure, self.trigger_activate):
                if trigger() != TransitionCallbackReturn.SUCCESS:
                    raise self._failure or RuntimeError("the drape node could not be started")
        except BaseException:
            self.destroy_node()
            raise
        finally:
            self._starting = False

    def on_configure(self, state) -> TransitionCallbackReturn:
        """Load models and bodies, and open the topics."""
        self._failure = None
        try:
            self._configure()
        except (ValueError, OSError, ImportError) as error:
            self._failure = error
            if not self._starting:
                self.get_logger().error(sentence(f"cannot configure: {error}"))
            self._take_down()
            return TransitionCallbackReturn.FAILURE
        except Exception as error:  # rclpy would swallow it
            self._failure = error
            if self.context.ok():  # else a signal came meanwhile
                self.get_logger().error(f"cannot configure: {traceback.format_exc()}")
            self._take_down()
            return TransitionCallbackReturn.ERROR
        return super().on_configure(state)

    def on_activate(self, state) -> TransitionCallbackReturn:
        """Answer joint states from now on."""
        self._set_active(True)
        return super().on_activate(state)

    def on_deactivate(self, state) -> TransitionCallbackReturn:
        """Answer no more; what is loaded stays."""
        self._set_active(False)
        return super().on_deactivate(state)

    def on_cleanup(self, state) -> TransitionCallbackReturn:
        """Take the topics down and forget the bodies."""
        self._take_down()
        return super().on_cleanup(state)

    def on_shutdown(self, state) -> TransitionCallbackReturn:
        """As cleaning up, for good."""
        self._take_down()
        return super().on_shutdown(state)

    def on_error(self, state) -> TransitionCallbackReturn:
        """Back to unconfigured."""
        self._take_down()
        return TransitionCallbackReturn.SUCCESS

    def destroy_node(self) -> None:
        """Take everything down, background work included."""
        self._worker.shutdown(wait=False, cancel_futures=True)
        self._take_down()
        self._loader.close()
        super().destroy_node()

    def _configure(self) -> None:
        self._settings = self._read_settings()
        for avatar in self._settings.avatars:
            check_orientation(avatar)  # a body that comes later must not fail for it
            if avatar.discover:
                self._discoveries[avatar.prefix] = BodyDiscovery(self._settings.max_bodies)
            else:
                stream = self._open(avatar)
                stream.dress(avatar)
                stream.listen()  # not before: what is sent in the meantime would be lost without being counted
        reports = Reports(self, lambda: list(self._streams.values()))
        self._opened.callback(reports.close)
        if not missing_interfaces():
            from physkin_ros.node.swap_services import SwapServices

            services = SwapServices(self, self._set_body, self._set_garment)
            self._opened.callback(services.close)
        if self._discoveries:
            steady = Clock(clock_type=ClockType.STEADY_TIME)  # simulated time may stand
            timer = self.create_timer(0.5, self._look_for_bodies, clock=steady)
            self._opened.callback(self.destroy_timer, timer)

    def _open(self, avatar: AvatarSettings) -> AvatarStream:
        stream = AvatarStream(self, avatar, self._loader, self._transforms, active=self._active)
        self._streams[avatar.id] = stream
        return stream

    def _set_active(self, active: bool) -> None:
        self._active = active
        for stream in self._streams.values():
            stream.active = active

    def _take_down(self) -> None:
        self._active = False
        for stream in self._streams.values():
            stream.close()
        self._streams, self._discoveries = {}, {}
        self._loader.cancel()  # nobody waits for what is being loaded
        self._opened.close()

    # Bodies that come and go.

    def _look_for_bodies(self) -> None:
        publishers = body_publishers(self)
        for template in self._settings.avatars:
            if (discovery := self._discoveries.get(template.prefix)) is None:
                continue
            waiting = discovery.waiting
            came, went = discovery.look(publishers)
            for body in went:
                if stream := self._streams.pop(body, None):
                    stream.close()
                    self.get_logger().info(f"{body}: the body is gone")
            for body in came:
                if body in self._streams:
                    self.get_logger().warning(f"{body}: a body of this id is dressed already; this one is ignored")
                    continue
                stream = self._open(_settings_for(template, body))
                stream.listen()
                self.get_logger().info(f"{body}: a body has come")
                self._worker.submit(self._dress_body, stream)
            if discovery.waiting - waiting:
                self.get_logger().warning(
                    f"{len(discovery.waiting)} bodies wait: parameter max_bodies is {self._settings.max_bodies}",
                    throttle_duration_sec=WARNING_PERIOD,
                )

    def _dress_body(self, stream: AvatarStream) -> None:
        if self._streams.get(stream.settings.id) is not stream:
            return  # the body has gone again
        try:
            stream.dress(stream.settings)
        except Exception as error:
            self._report_swap(stream, error)

    # Swaps.

    def _set_body(self, request, response):
        def swap(stream: AvatarStream) -> LoadedWear:
            self._roots.check_body(request.body_mesh)
            loaded = stream.dress(replace(stream.settings, body_mesh=request.body_mesh))
            self._show_settings(stream, (f"{stream.settings.prefix}body_mesh",))
            return loaded

        return self._answer(request, response, swap)

    def _set_garment(self, request, response):
        def swap(stream: AvatarStream) -> LoadedWear:
            index = _one_of("garment", request.garment, [each.name for each in stream.settings.garments])
            if not request.model:
                raise SettingsError("model must not be empty")
            self._roots.check_garment(request.model)
            garments = list(stream.settings.garments)
            garments[index] = replace(garments[index], model=request.model)
            loaded = stream.dress(replace(stream.settings, garments=tuple(garments)))
            self._show_settings(stream, (f"{garments[index].prefix}model",))
            return loaded

        return self._answer(request, response, swap)

    def _answer(self, request, response, swap: Callable[[AvatarStream], LoadedWear]):
        """Run a swap on the worker and tell how it went. Runs on the services' own thread."""
        stream = None
        try:
            streams = list(self._streams.values())
            stream = streams[_one_of("avatar", request.avatar, [stream.settings.id for stream in streams])]
            loaded = self._worker.submit(swap, stream).result()
        except Exception as error:
            response.success, response.message = False, self._report_swap(stream, error)
            return response
        names = ", ".join(layer.name for layer in loaded.outfit.layers)
        response.success, response.message = True, f"{names} on {loaded.outfit.avatar.source}"
        response.seconds, response.cached = loaded.seconds, loaded.cached
        return response

    def _report_swap(self, stream: AvatarStream | None, error: Exception) -> str:
        """Log and count a swap that failed; returns why."""
        known = isinstance(error, (ValueError, OSError))
        reason = sentence(str(error) if known else f"{type(error).__name__}: {error}")
        if stream is not None:
            stream.statistics.count("swaps_failed", reason)
        if self.context.ok():  # else a signal has ended it
            self.get_logger().error(f"swap failed, the old one stays on: {reason}")
        return reason


def _parameters_of(worn: AvatarSettings) -> dict[str, str]:
    """What the parameters say of body and garments when these are worn, by full name."""
    values = {worn.prefix + "body_mesh": worn.body_mesh}
    if worn.prefix:
        return values | {garment.prefix + "model": garment.model for garment in worn.garments}
    return values | {"model": ",".join(garment.model for garment in worn.garments)}


def _settings_for(template: AvatarSettings, body: str) -> AvatarSettings:
    """The settings of one discovered body."""
    return replace(template, id=body, joint_map=template.joint_map or ROS4HRI, frame_id=f"body_{body}")


def _one_of(kind: str, name: str, names: list[str]) -> int:
    """Index of `name` among `names`; an empty one will do where there is one only. Raises SettingsError."""
    if name in names:
        return names.index(name)
    if not name and len(names) == 1:
        return 0
    raise SettingsError(f"no {kind} {name!r}; allowed: {', '.join(map(repr, names)) or 'none, there is none yet'}")


def _schedule_as_batch() -> None:
    """Tell Linux that this thread computes and nobody waits for it: the executor's thread then gets a core sooner."""
    if hasattr(os, "SCHED_BATCH"):
        os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
