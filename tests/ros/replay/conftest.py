"""Fixtures of the replay tests: a clip as a bag, a garment that heeds gravity, and what replaying gives."""

from __future__ import annotations

import numpy as np
import pytest

from physkin_core import BUNDLED_AVATAR, Draper, Motion, load_avatar, load_garment_model, load_motion


@pytest.fixture(scope="session")
def avatar(leaning_model):
    """Read once: it takes seconds."""
    return load_avatar(BUNDLED_AVATAR, leaning_model.rig)


@pytest.fixture
def quick(avatar, monkeypatch):
    """For the command line: the avatar that was read already, and blank pictures."""
    blank = np.zeros((4, 4, 3), dtype=np.uint8)
    monkeypatch.setattr("physkin_ros.replay.report.render", lambda *_, **__: blank)
    monkeypatch.setattr("physkin_ros.replay.command.chosen_avatar", lambda *arguments, **settings: avatar)


@pytest.fixture(scope="session")
def draper(leaning_model_path, avatar):
    """Of a garment that heeds gravity; from the file, which rounds."""
    return Draper(load_garment_model(leaning_model_path), avatar)


@pytest.fixture(scope="session")
def motion():
    """A few frames of a body that leans."""
    clip = load_motion("cartwheel")
    fields = ("positions", "root_orientation", "root_position")
    return Motion(clip.joint_names, *(getattr(clip, name)[:12] for name in fields), clip.rate_hz, "cartwheel")


@pytest.fixture(scope="session")
def bag(motion, tmp_path_factory):
    """The clip as a bag."""
    from physkin_ros.replay.bags import BagWriter, write_motion

    path = tmp_path_factory.mktemp("bags") / "crawl.mcap"
    with BagWriter(path) as writer:
        write_motion(writer, motion, frame_id="torso")
    return path


@pytest.fixture(scope="session")
def run(draper):
    """Replays a bag: what came of it, and its figures."""
    from physkin_core.motion.bag_reader import BagReader
    from physkin_ros.replay.figures import describe
    from physkin_ros.replay.replay import replay

    def replayed(path, *, contact_every=0, **settings):
        with BagReader(path) as bag:
            found = replay(draper, bag, contact_every=contact_every, **settings)
            return found, describe(found, draper, bag, contact_every=contact_every)

    return replayed


@pytest.fixture(scope="session")
def found_and_figures(run, bag):
    """Of the clip, contact on every fourth cloud."""
    return run(bag, contact_every=4)


@pytest.fixture(scope="session")
def figures(found_and_figures):
    return found_and_figures[1]
