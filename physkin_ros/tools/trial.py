"""A drape node in a process of its own, a motion that is played to it, and what comes back.

The motion is played from another process, so that sending and receiving do not wait for each other. Dimensions: `K`
avatars, `G` garments of each, `T` joint states sent to each. Times are CLOCK_MONOTONIC, which a machine's processes
share [ns].
"""

from __future__ import annotations

import multiprocessing
import signal
import struct
import subprocess
import sys
import time
from array import array
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np
import rclpy
import yaml
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Vector3, Vector3Stamped
from rclpy.duration import Duration
from rclpy.executors import Executor
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message, serialize_message
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState, PointCloud2

from physkin_core import Motion
from physkin_ros.messages.conversions import read_cloud
from physkin_ros.messages.topics import DIAGNOSTICS
from physkin_ros.middleware.shared_memory import remove_shared_memory, shared_memory_of
from physkin_ros.middleware.spinning import spin_until, wait_for_subscribers

__all__ = ["NodeProcess", "Records", "TrialError", "node_parameters", "play_to_node", "processor_time"]

SECOND = 1_000_000_000
ANSWER_SECONDS, PLAY_SECONDS, STOP_SECONDS = 100.0, 100.0, 5.0
ASK_EVERY = 0.2
"""[s] between two joint states that ask whether a garment answers."""
DRAIN_SECONDS, SILENCE_SECONDS = 0.3, 1.0
"""Left for what is on its way: of joint states before the player ends, of clouds after the last one."""
STAMP, STAMP_OFFSET = struct.Struct("=iI"), 4
"""Where a stamp is in any message that begins with a header: after the encapsulation."""


class TrialError(RuntimeError):
    """The node ended, or did not answer in time."""


@dataclass(frozen=True)
class Records:
    """What came back of joint states.

    counts, delays: (T, K, G) clouds with the stamp of each, and how late the first of them came [ms], NaN without one.
    strangers: clouds of other stamps. not_finite: clouds with such values, looked for where clouds are kept. kept: by
    frame, clouds (n, 6) of all garments of the first avatar. reports: the node's diagnostics, values by name. measured:
    what the player measured, at the beginning and at the end.
    """

    counts: np.ndarray
    delays: np.ndarray
    strangers: int = 0
    not_finite: int = 0
    kept: Mapping[int, Sequence[np.ndarray]] = field(default_factory=dict)
    reports: Sequence[Mapping[str, str]] = ()
    measured: Sequence = ()


def node_parameters(avatars: int, garments: Sequence[Mapping], **avatar) -> dict:
    """Parameters of a node with avatars a0, a1, ..., each in garments g0, g1, ... from the skin outwards.

    garments, avatar: parameters of each garment and of every avatar."""
    worn = [{f"g{k}": dict(garment) for k, garment in enumerate(garments)} for _ in range(avatars)]
    return {"avatars": {f"a{k}": {**avatar, "garments": each} for k, each in enumerate(worn)}}


class NodeProcess:
    """`physkin node` with these ROS parameters, from `with` to its end; it leaves no shared memory behind.

    folder: for its configuration and what it says.
    """

    def __init__(self, parameters: Mapping, folder: Path) -> None:
        config, self._log = folder / "avatars.yaml", folder / "node.log"
        config.write_text(yaml.safe_dump({"drape_node": {"ros__parameters": dict(parameters)}}, sort_keys=False))
        command = [sys.executable, "-m", "physkin_core.cli", "node", "--config", str(config)]
        with open(self._log, "w") as log:  # in a session of its own: a terminal's Ctrl+C reaches this process alone
            self._process = subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT, start_new_session=True)
        self.pid = self._process.pid

    def __enter__(self) -> NodeProcess:
        return self

    def __exit__(self, *exception) -> None:
        opened = shared_memory_of(self.pid)
        self._process.send_signal(signal.SIGINT)
        try:
            self._process.wait(STOP_SECONDS)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
            remove_shared_memory(opened)

    def log(self) -> str:
        """What it has said so far."""
        return self._log.read_text(errors="replace")

    def check(self) -> None:
        """Raise TrialError once it has ended."""
        if self._process.poll() is not None:
            raise TrialError(f"the node ended with status {self._process.returncode}:\n{self.log()}")


def processor_time(pid: int) -> tuple[float, float]:
    """Processor time [s] of a process's first thread and of all its living threads; zeros where no /proc tells it."""
    total = 0.0
    for task in Path("/proc").glob(f"{pid}/task/*"):
        with suppress(FileNotFoundError):  # the thread has ended meanwhile
            total += int((task / "schedstat").read_text().split()[0]) / 1e9
    first = Path(f"/proc/{pid}/task/{pid}/schedstat")
    return int(first.read_text().split()[0]) / 1e9 if first.exists() else 0.0, total


class Listener(Node):
    """Collects the clouds of avatars a0, a1, ... and their garments g0, g1, ..., and the node's diagnostics.

    arrived: when clouds came, by avatar, garment and stamp. keep_every: of every so many answered joint states of a0
    one is kept with the points of its clouds, and all are checked to be finite; 0: none. check: called while waiting.
    """

    def __init__(
        self, avatars: int, garments: int, *, keep_every: int = 0, check: Callable[[], None] = lambda: None
    ) -> None:
        super().__init__("listener")
        self.arrived: dict[tuple[int, int, int], list[int]] = defaultdict(list)
        self.kept: dict[int, dict[int, np.ndarray]] = {}
        self.not_finite, self.reports = 0, []
        self._avatars, self._garments, self._keep_every, self._check = avatars, garments, keep_every, check
        self._asked: set[int] = set()
        self._order: dict[int, int] = {}
        self._silent = {(avatar, garment) for avatar in range(avatars) for garment in range(garments)}
        deep = QoSProfile(depth=1000)  # what is lost on the way is counted, not what is read late
        for avatar, garment in sorted(self._silent):
            topic, took = f"drape_node/a{avatar}/g{garment}/garment", partial(self._on_cloud, avatar, garment)
            self.create_subscription(PointCloud2, topic, took, deep, raw=True)
        self.create_subscription(DiagnosticArray, DIAGNOSTICS.name, self._on_diagnostics, 10)

    def wait_until_answered(self, executor: Executor, motion: Motion) -> None:
        """Send the first pose of a motion until each garment has answered: a node that is discovered may still be
        loading a garment, and need not know of this reader yet. Raises TrialError."""
        state = JointState(name=list(motion.joint_names), position=array("d", motion.positions[0].tolist()))
        publishers = [self.create_publisher(JointState, f"a{k}/joint_states", 1) for k in range(self._avatars)]
        end = time.monotonic() + ANSWER_SECONDS
        while self._silent:
            self._check()
            if time.monotonic() > end:
                raise TrialError(f"the node did not answer joint states for {ANSWER_SECONDS:.0f} s")
            for k in {avatar for avatar, _ in self._silent}:
                now = time.monotonic_ns()
                state.header.stamp.sec, state.header.stamp.nanosec = divmod(now, SECOND)
                self._asked.add(now)
                publishers[k].publish(state)
            spin_until(executor, ASK_EVERY, lambda: not self._silent)
        for publisher in publishers:
            self.destroy_publisher(publisher)
        self.reports.clear()

    def records(self, stamps: np.ndarray, measured: Sequence = ()) -> Records:
        """What came of joint states of these stamps (T, K)."""
        counts, delays = np.zeros((2, *stamps.shape, self._garments))
        for (frame, avatar), stamp in np.ndenumerate(stamps):
            for garment in range(self._garments):
                arrived = self.arrived.get((avatar, garment, stamp), ())
                counts[frame, avatar, garment] = len(arrived)
                delays[frame, avatar, garment] = (arrived[0] - stamp) / 1e6 if arrived else np.nan
        frames = {stamp: frame for frame, stamp in enumerate(stamps[:, 0].tolist())}
        kept = {
            frames[stamp]: [clouds[garment] for garment in range(self._garments)]
            for stamp, clouds in self.kept.items()
            if stamp in frames and len(clouds) == self._garments
        }
        strangers = sum(map(len, self.arrived.values())) - int(counts.sum())
        return Records(counts, delays, strangers, self.not_finite, kept, self.reports, measured)

    def _on_cloud(self, avatar: int, garment: int, data: bytes) -> None:
        received = time.monotonic_ns()
        sec, nanosec = STAMP.unpack_from(data, STAMP_OFFSET)
        stamp = SECOND * sec + nanosec
        if stamp in self._asked:
            self._silent.discard((avatar, garment))
            return
        self.arrived[avatar, garment, stamp].append(received)
        if self._keep_every:
            points = read_cloud(deserialize_message(data, PointCloud2))
            self.not_finite += not np.isfinite(points).all()
            order = self._order.setdefault(stamp, len(self._order))
            if avatar == 0 and order % self._keep_every == 0:
                self.kept.setdefault(stamp, {})[garment] = points.copy()

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        self.reports += [{value.key: value.value for value in status.values} for status in message.status]


def play_to_node(
    motion: Motion,
    *,
    avatars: int = 1,
    garments: int = 1,
    keep_every: int = 0,
    check: Callable[[], None] = lambda: None,
    **played,
) -> Records:
    """Play a motion to each avatar of a node, once every garment answers, and listen until no more clouds come.

    garments: of each avatar. keep_every, check: as of `Listener`. played: as of `play`. Raises TrialError.
    """
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)  # Ctrl+C is this process's to handle
    executor, listener = EventsExecutor(), Listener(avatars, garments, keep_every=keep_every, check=check)
    executor.add_node(listener)
    try:
        listener.wait_until_answered(executor, motion)
        with multiprocessing.get_context("spawn").Pool(1, signal.signal, (signal.SIGINT, signal.SIG_IGN)) as pool:
            playing = pool.apply_async(play, (motion, avatars), played)
            end = time.monotonic() + PLAY_SECONDS + 4 * motion.frame_count / motion.rate_hz
            while not spin_until(executor, 1.0, playing.ready):
                check()
                if time.monotonic() > end:
                    raise TrialError("the motion was not played in time")
            stamps, measured = playing.get()
        played_at, count = set(stamps.flat), -1
        while count < (arrived := sum(stamp in played_at for *_, stamp in listener.arrived)):
            count = arrived  # of this motion: others may go on publishing
            spin_until(executor, SILENCE_SECONDS, lambda: False)
        return listener.records(stamps, measured)
    finally:
        executor.remove_node(listener)
        listener.destroy_node()
        rclpy.try_shutdown()


def play(
    motion: Motion,
    avatars: int,
    *,
    gravity: bool = False,
    measure: Callable[[], object] | None = None,
) -> tuple[np.ndarray, list]:
    """Publish a motion on `a0/joint_states` and so on at its rate, the avatars' joint states evenly spread over each
    period; a process's own.

    gravity: send its direction on `a0/gravity` before each. measure: called before the first joint state, and when
    everything has arrived. Returns stamps (T, K) [ns], taken right before sending, and what was measured. Raises
    TimeoutError when nobody listens.
    """
    rclpy.init(args=[])
    node, quality = rclpy.create_node("player"), QoSProfile(depth=100)
    publishers = [node.create_publisher(JointState, f"a{k}/joint_states", quality) for k in range(avatars)]
    downs = [node.create_publisher(Vector3Stamped, f"a{k}/gravity", quality) for k in range(avatars * gravity)]
    wait_for_subscribers(*publishers, *downs)
    stamps = np.empty((motion.frame_count, avatars), dtype=np.int64)
    measured = [] if measure is None else [measure()]
    message, start = JointState(name=list(motion.joint_names)), time.monotonic()
    for tick, (positions, (x, y, z)) in enumerate(zip(motion.positions.astype(np.float64), motion.gravity.tolist())):
        message.position = array("d", positions.tolist())
        state = bytearray(serialize_message(message))
        down = bytearray(serialize_message(Vector3Stamped(vector=Vector3(x=x, y=y, z=z))))
        for k, publisher in enumerate(publishers):
            time.sleep(max(0.0, start + (tick + k / avatars) / motion.rate_hz - time.monotonic()))
            stamps[tick, k] = now = time.monotonic_ns()
            if gravity:  # first: a joint state is draped with the latest
                downs[k].publish(_stamped(down, now))
            publisher.publish(_stamped(state, now))
    for publisher in publishers:
        publisher.wait_for_all_acked(Duration(seconds=5))
    time.sleep(DRAIN_SECONDS)
    if measure is not None:
        measured.append(measure())
    rclpy.try_shutdown()
    return stamps, measured


def _stamped(data: bytearray, time_ns: int) -> bytes:
    STAMP.pack_into(data, STAMP_OFFSET, *divmod(time_ns, SECOND))
    return bytes(data)
