"""One node while damaged bodies and garments come among good ones: each cloud is of what was put on last."""

from __future__ import annotations

import os
import time
from itertools import count
from pathlib import Path

import numpy as np
import pytest
from fuzzing import damaged

from physkin_core import BUNDLED_AVATAR, Draper, load_avatar, load_garment_model
from physkin_core.file_reading import LONGEST_SENTENCE
from physkin_core.model.model_file import MODELS_PATH

pytest.importorskip("rclpy", reason="needs rclpy: pip install 'physkin[ros]'")
pytest.importorskip("physkin_msgs", reason="needs physkin_msgs: python msg_defs/wheel/build.py --install")

from drape_site import scaled_body  # noqa: E402
from physkin_msgs.srv import SetBody, SetGarment  # noqa: E402

TOP, TOPIC = "alice/top", "/alice/joint_states"
RATE_HZ = 30


class Streamer:
    """Sends poses to the node of a site, and compares each cloud with what was worn by then.

    worn: what drapes now; clouds of the one before come until the first of it. compared, changes: how many clouds were
    right, and how often another draper's came.
    """

    def __init__(self, site, worn: Draper) -> None:
        self.site, self.worn, self.compared, self.changes = site, worn, 0, 0
        self._stamps, self._sent = count(1), {}
        self._random, self._due = np.random.default_rng(7), time.monotonic()

    def send(self) -> None:
        """Send a pose when it is time to, and serve callbacks."""
        if time.monotonic() >= self._due:
            self._due = max(self._due + 1 / RATE_HZ, time.monotonic() - 0.5)
            rig = self.worn.model.rig
            pose, stamp = self._random.uniform(rig.lower, rig.upper).astype(np.float32), (next(self._stamps), 0)
            message = self.site.state(rig.joint_names, pose)
            message.header.stamp.sec, message.header.stamp.nanosec = stamp
            self.site.publisher(TOPIC).publish(message)
            self._sent[stamp] = pose
        self.site.executor.spin_once(timeout_sec=0.002)

    def swapped(self, new: Draper | None) -> None:
        """Compare what has been sent up to now, and a few frames more: with what is worn, or from some message on with
        `new`; by the last of them that is worn."""
        self.site.until(lambda: all((TOP, stamp) in self.site.clouds for stamp in self._sent), "all clouds")
        drapers = [self.worn] if new is None else [self.worn, new]
        for stamp, pose in sorted(self._sent.items()):
            points, _ = self.site.clouds.pop((TOP, stamp))
            if not np.array_equal(points, drapers[0].drape(pose)):
                assert len(drapers) == 2, f"cloud {stamp} is of something that is not worn"
                np.testing.assert_array_equal(points, drapers[1].drape(pose))
                del drapers[0]
                self.changes += 1
            self.compared += 1
        self._sent.clear()
        if new is not None:
            self.worn = new


def draper(body: str, model: str) -> Draper:
    loaded = load_garment_model(model)
    return Draper(loaded, load_avatar(body, loaded.rig))


@pytest.mark.slow
@pytest.mark.parametrize("seconds", [60, 1800])
def test_clouds_are_right_throughout(start_site, tmp_path, seconds):
    """Every other file is damaged; it is refused in a sentence, or it is worn as it is."""
    folder = tmp_path / "bodies"
    folder.mkdir()
    bodies = {f"{factor}.glb": scaled_body(factor) for factor in (0.95, 1.0, 1.05)}
    models = {
        path.name: path.read_bytes() for path in (MODELS_PATH / f"{name}.safetensors" for name in ("tshirt", "dress"))
    }
    for name, content in (bodies | models).items():
        (folder / name).write_bytes(content)
    garment = {"model": str(folder / "tshirt.safetensors")}
    avatars = {"alice": {"sway": 0.0, "garments": {"top": garment}}}
    site = start_site({"asset_roots": [str(folder)], "avatars": avatars}, [TOP])
    site.publisher(TOPIC)
    site.until(lambda: TOP in site.statuses, "diagnostics")
    worn = [str(BUNDLED_AVATAR), garment["model"]]
    streamer = Streamer(site, draper(*worn))
    outcomes = dict.fromkeys(("good", "refused", "harmless"), 0)
    services = (SetBody, "set_body", "body_mesh", bodies), (SetGarment, "set_garment", "model", models)
    clients = [site.node.create_client(kind, f"/drape_node/{name}") for kind, name, _, _ in services]
    site.until(lambda: all(client.service_is_ready() for client in clients), "services")
    memory, ends = [], time.monotonic() + seconds
    for seed in count():
        if time.monotonic() > ends:
            break
        which = seed // 2 % 2
        kind, _, field, files = services[which]
        name, content = list(files.items())[seed // 4 % len(files)]
        path = folder / name
        if seed % 2:
            path = folder / f"damaged_{seed}_{name}"
            path.write_bytes(damaged(content, seed))
        future = clients[which].call_async(kind.Request(avatar="alice", **{field: str(path)}))
        while not future.done():
            assert site.process.poll() is None
            streamer.send()
        answer, new = future.result(), None
        if answer.success:
            outcomes["harmless" if seed % 2 else "good"] += 1
            if "damaged" in worn[which]:
                Path(worn[which]).unlink()
            worn[which] = str(path)
            new = draper(*worn)
        else:
            if seed % 2:
                path.unlink()
            else:  # a good garment does not drape on any damaged body that was worn as it is, nor the other way round
                assert "damaged" in worn[1 - which] and "does not drape on" in answer.message, answer.message
            assert len(answer.message) <= LONGEST_SENTENCE and answer.message.isprintable(), answer.message
            outcomes["refused"] += 1
        for _ in range(20):
            streamer.send()
        streamer.swapped(new)
        pages = int(Path(f"/proc/{site.process.pid}/statm").read_text().split()[1])
        memory.append(pages * os.sysconf("SC_PAGE_SIZE") / 1e6)
    print(
        f"soak: {seconds} s, swaps {outcomes}, {streamer.compared} clouds right, {streamer.changes} times of something "
        f"else; memory {memory[0]:.0f} to {memory[-1]:.0f} MB"
    )
    assert min(outcomes["good"], outcomes["refused"]) > seconds / 30 and streamer.compared > 5 * seconds
