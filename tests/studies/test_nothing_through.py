"""Skin that comes through cloth, and layers through each other, in a clip."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from physkin_core.avatar.loading import BUNDLED_AVATAR
from physkin_core.motion.loading import load_motion
from physkin_studies import nothing_through
from physkin_studies.nothing_through import BODIES, HEADS, avatar_of, main, play
from physkin_training.physics.surface_queries import BodySurface

FRAMES = 6
PARTS = ("positions", "root_orientation", "root_position")


@pytest.fixture(scope="module")
def walk():
    """The start of the shipped one."""
    motion = load_motion("walk").resampled(nothing_through.RATE)
    return replace(motion, **{name: getattr(motion, name)[:FRAMES] for name in PARTS})


def test_vertices_inside_the_skin_are_counted_in_every_frame(walk, monkeypatch):
    """As many as a body says that swallows three of those that hang in every other frame, one by a forearm; where it
    runs into itself, these are told apart."""
    of_arms = []
    found = nothing_through._of_arms

    def remembered(avatar, rig):
        of_arms.append(found(avatar, rig))
        return of_arms[-1]

    class Swallowing(BodySurface):
        def closest(self, points):
            closest = super().closest(points)
            if not of_arms:
                return closest
            distance, face = np.full_like(closest.distance, 0.1), np.full_like(closest.face, (~of_arms[0]).argmax())
            distance[:3] = -0.003
            distance[3:9] = -0.001
            face[2] = of_arms[0].argmax()
            return replace(closest, distance=distance, face=face)

        def surrounds(self, points, *, times=1):
            return np.arange(len(points)) == times - 1

    monkeypatch.setattr(nothing_through, "_of_arms", remembered)
    monkeypatch.setattr(nothing_through, "BodySurface", Swallowing)
    (row,) = play(["skirt"], ["bundled"], [walk], every=2)
    looked_up = FRAMES // 2
    assert row.inside.tolist() == [3] * looked_up and row.but_arms.tolist() == [2] * looked_up
    assert row.apart.tolist() == [0] * looked_up  # one is inside two parts, the other over skin inside another part
    assert 0.01 < of_arms[0].mean() < 0.5 and len(row.seen) == 0
    assert dict(zip(HEADS, row.cells()))["% of frames above 3"] == "0.0"


def test_an_outfit_has_pixels_and_what_its_layers_cost(walk, capsys, monkeypatch):
    """A row for each outfit; a shirt over a skirt is stretched by it, and looked at."""
    monkeypatch.setattr(nothing_through, "OUTFITS", ("skirt,longsleeve", "skirt"))
    monkeypatch.setattr(nothing_through, "load_motion", lambda clip: walk)
    assert main(["walk", "--bodies", "average"]) == 0
    heads, _, *rows = [line.strip("| ").split(" | ") for line in capsys.readouterr().out.splitlines()]
    assert heads == list(HEADS) and [row[:2] for row in rows] == [["skirt,longsleeve", "average"], ["skirt", "average"]]
    over, alone = (dict(zip(heads, row)) for row in rows)
    assert over["frames"] == str(FRAMES) and float(over["seen pokes %"]) < 0.5
    assert float(over["added strain"]) > float(alone["added strain"]) > -1 and 0.5 < float(alone["jitter"]) < 1.5


def test_without_sway_a_frame_is_what_its_pose_says(walk):
    """The first frames of a clip that starts at speed: with sway, cloth lags behind, and is not as still."""
    (swaying,), (still,) = (list(play(["skirt"], ["bundled"], [walk], sway=sway, every=FRAMES)) for sway in (1.0, 0.0))
    assert swaying.jitter != still.jitter and len(still.inside) == 1


def test_an_avatar_may_be_a_file():
    """Other than a person of the body model by name."""
    assert len(avatar_of(str(BUNDLED_AVATAR)).vertices) == len(avatar_of("bundled").vertices)


def test_bodies_are_unlike_each_other():
    """Each has a height of its own."""
    heights = [float(np.ptp(avatar_of(body).vertices[:, 2])) for body in BODIES]
    assert len({round(height, 3) for height in heights}) == len(BODIES)
    assert heights[BODIES.index("child")] < 1.3 < heights[BODIES.index("giant")]
