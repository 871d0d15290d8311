"""Sixteen garments at 60 Hz while bodies are swapped and publishers come and go: nothing lost, nothing grows."""

from __future__ import annotations

import os
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pytest

from physkin_core import BUNDLED_AVATAR, load_garment_model, load_motion

rclpy = pytest.importorskip("rclpy", reason="needs rclpy: pip install 'physkin[ros]'")

from sensor_msgs.msg import JointState  # noqa: E402

from physkin_ros.tools.demo import delivered_percent  # noqa: E402
from physkin_ros.tools.trial import NodeProcess, node_parameters, play_to_node  # noqa: E402

pytest.importorskip("physkin_msgs", reason="needs physkin_msgs: python msg_defs/wheel/build.py --install")

from drape_site import Site, glb_joined, glb_parts  # noqa: E402
from physkin_msgs.srv import SetBody  # noqa: E402

GARMENTS, RATE_HZ = 16, 60
SWAP_SECONDS = 1.2
SETTLED = 0.6  # share of the time after which as many bodies are kept as ever will be: in less than 72 s they are not
MODEL = "tshirt"


@dataclass
class Usage:
    """What the node's process holds, a sample a second: time [s], resident memory [MB], open files, threads."""

    pid: int
    samples: list[tuple[float, float, int, int]] = field(default_factory=list)

    def sample(self) -> None:
        process = Path(f"/proc/{self.pid}")
        pages = int((process / "statm").read_text().split()[1])
        descriptors, threads = (len(os.listdir(process / name)) for name in ("fd", "task"))
        megabytes = pages * os.sysconf("SC_PAGE_SIZE") / 1e6
        self.samples.append((time.monotonic(), megabytes, descriptors, threads))

    def settled(self) -> np.ndarray:
        """The later samples."""
        samples = np.array(self.samples)
        return samples[int(SETTLED * len(samples)) :]

    def growth(self) -> float:
        """[MB] that the line through the settled samples rises by from their first to their last."""
        seconds, megabytes, _, _ = self.settled().T
        return float(np.polyfit(seconds, megabytes, 1)[0] * (seconds[-1] - seconds[0]))


@pytest.mark.slow
@pytest.mark.parametrize("seconds", [120, 600])
def test_soak(domain, tmp_path, seconds):
    """At most one cloud in a thousand is lost; memory and files do not grow; nothing is logged that should not be.

    Where others keep all cores busy, up to one in twenty: all this takes most of a core by itself.
    """
    others = os.getloadavg()[0]
    bodies = tmp_path / "bodies"
    bodies.mkdir()
    parameters = node_parameters(GARMENTS, [{"model": MODEL}]) | {"asset_roots": [str(bodies)]}
    motion = load_motion("dance").resampled(RATE_HZ).looped(seconds)
    with NodeProcess(parameters, tmp_path) as node, ProcessPoolExecutor(1, get_context("spawn")) as pool:
        site = Site(domain, node._process, [])
        try:
            playing = pool.submit(play_to_node, motion, avatars=GARMENTS)
            usage, swaps = _disturb(site, bodies, playing.done)
            records = playing.result()
        finally:
            site.close()
    text, delivered = node.log(), delivered_percent(records)
    p50, p99 = np.nanpercentile(records.delays, (50, 99))
    settled = usage.settled()
    assert swaps > 1.5 * GARMENTS
    print(
        f"soak: {seconds} s, {records.counts.size} joint states, {delivered:.3f} % delivered, {swaps} swaps, "
        f"p50 {p50:.2f} ms, p99 {p99:.2f} ms, load {os.getloadavg()[0]:.1f}; "
        f"memory {usage.samples[0][1]:.0f} to {settled[-1, 1]:.0f} MB, of which {usage.growth():.2f} MB in the last "
        f"{settled[-1, 0] - settled[0, 0]:.0f} s; {settled[-1, 2]:.0f} files, {settled[-1, 3]:.0f} threads"
    )
    assert delivered >= (99.9 if others < os.cpu_count() else 95), f"load {others:.1f} before"
    assert usage.growth() < 3.0 + seconds / 60
    assert np.ptp(settled[:, 2]) <= 2 and np.ptp(settled[:, 3]) <= 1
    assert "Traceback" not in text and "[ERROR]" not in text and "could not be handled" not in text


def _disturb(site: Site, bodies: Path, done) -> tuple[Usage, int]:
    """Until `done()`: put a body never seen before on one avatar after another, while somebody else publishes too."""
    usage, swaps, random = Usage(site.process.pid), 0, np.random.default_rng(4)
    document, rest = glb_parts(BUNDLED_AVATAR.read_bytes())
    scene = document["scenes"][document.get("scene", 0)]
    document["nodes"].append({"children": scene["nodes"], "scale": [1, 1, 1]})
    scene["nodes"] = [len(document["nodes"]) - 1]
    rig = load_garment_model(MODEL).rig
    while not done():
        ends = time.monotonic() + SWAP_SECONDS
        avatar, path = f"a{swaps % GARMENTS}", bodies / f"{swaps}.glb"
        document["nodes"][-1]["scale"] = [random.uniform(0.9, 1.1)] * 3
        path.write_bytes(glb_joined(document, rest))
        guest = site.node.create_publisher(JointState, f"/{avatar}/joint_states", 10)
        answer = site.call(SetBody, "set_body", avatar=avatar, body_mesh=str(path))
        assert answer.success and not answer.cached, answer.message
        swaps += 1
        path.unlink()
        while time.monotonic() < ends:
            guest.publish(site.state(rig.joint_names, rig.rest))
            site.spin(0.1)
        site.node.destroy_publisher(guest)
        usage.sample()
    return usage, swaps
