"""Figures of outfits: what is pushed through is counted, by depth and by sight; holes are seen; the command refuses."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from random_models import tube

from physkin_core import load_motion
from physkin_core.model.garment import vertex_normals
from physkin_core.motion.loading import save_motion
from physkin_training.evaluate.command import main
from physkin_training.evaluate.layer_pokes import CAMERAS, HEM, Surface, bind_layer_pokes, camera_rays, holes, look
from physkin_training.evaluate.outfit_evaluation import parse_outfit

INNER, OUTER = (tube(rings=25, segments=60, radius=radius) for radius in (0.15, 0.156))
FACES = INNER.faces, OUTER.faces
HEIGHT = INNER.vertices[:, 2]
MIDDLE = int(np.abs(INNER.vertices - [0.15, 0, (HEIGHT.min() + HEIGHT.max()) / 2]).sum(axis=1).argmin())
FIGURES = {
    *("poke_percent", "poke_p999_mm", "seen_poke_percent", "seen_through_percent", "seen_hole_percent"),
    *("covered_vertices", "pixels"),
}


@pytest.fixture(scope="module")
def pokes():
    return bind_layer_pokes(INNER.vertices, OUTER.vertices, FACES)


def pushed(vertex, distance):
    """The inner tube with one vertex moved off the axis."""
    vertices = INNER.vertices.copy()
    vertices[vertex, :2] *= 1 + distance / 0.15
    return vertices


def test_what_is_covered_lies_away_from_the_hems(pokes):
    from_hem = np.minimum(HEIGHT - HEIGHT.min(), HEIGHT.max() - HEIGHT)
    spacing = np.diff(np.unique(HEIGHT)).max()
    assert pokes.covered[from_hem > HEM + spacing].all() and not pokes.covered[from_hem < HEM].any()
    assert pokes.covering[from_hem > HEM + spacing].all() and not pokes.covering[from_hem < HEM].any()


def test_a_vertex_pushed_through_is_as_deep_as_it_stands_out(pokes):
    normals = vertex_normals(INNER.vertices, INNER.faces)
    assert not pokes.depths(INNER.vertices, normals, OUTER.vertices).any()
    for distance in (0.008, 0.016):
        depths = pokes.depths(pushed(MIDDLE, distance), normals, OUTER.vertices)
        assert list(np.flatnonzero(depths)) == [MIDDLE]
        assert depths[MIDDLE] == pytest.approx(distance - 0.006, abs=3e-4)


def test_cloth_at_a_hem_or_of_another_part_does_not_poke(pokes):
    """Below the outer tube's edge, far outside it, or facing the other way."""
    normals = vertex_normals(INNER.vertices, INNER.faces)
    at = np.stack([[0.16, 0, HEIGHT.min() + 0.01], [0.23, 0, HEIGHT.mean()], [0.16, 0, HEIGHT.mean()]])
    facing = np.stack([normals[MIDDLE], normals[MIDDLE], -normals[MIDDLE]])
    assert not pokes.depths(at, facing, OUTER.vertices).any()
    assert pokes.depths(at[2:], -facing[2:], OUTER.vertices) == pytest.approx(0.004, abs=3e-4)


def test_a_vertex_pushed_through_is_seen_from_its_side_alone():
    """Cameras on its side see the inner tube there, as large as what stands out; none sees it elsewhere."""
    rays = camera_rays(OUTER.vertices)
    right_way = look([INNER, OUTER], rays)
    at_rim = INNER.vertices[INNER.faces][..., 2].max(axis=1) == HEIGHT.max()  # cameras look down into the gap
    assert not ((right_way.surface == 0) & right_way.facing & ~at_rim[right_way.face]).any()
    spike = look([Surface(pushed(MIDDLE, 0.02), INNER.faces), OUTER], rays)
    seen = (spike.surface == 0) & spike.facing & ~at_rim[spike.face]
    camera = np.unique(rays[1], axis=0, return_inverse=True)[1].reshape(-1)
    azimuth = np.arctan2(-rays[1][:, 1], -rays[1][:, 0])
    assert len(np.unique(camera)) == CAMERAS and len(np.unique(camera[seen])) in range(3, 6)
    assert np.abs(azimuth[seen]).max() < np.pi / 2 + 0.01
    at = rays[0][seen] + spike.distance[seen, None] * rays[1][seen]
    assert np.linalg.norm(at - pushed(MIDDLE, 0.02)[MIDDLE], axis=1).max() < 0.04


def test_a_hole_is_seen_where_nothing_covers_what_was_removed():
    """A removed patch under whole outer cloth leaves none; without the outer cloth there, its pixels."""
    rays = camera_rays(OUTER.vertices)
    near = np.linalg.norm(INNER.vertices - INNER.vertices[MIDDLE], axis=1) < 0.04
    patch = near[INNER.faces].all(axis=1)
    kept, removed = Surface(INNER.vertices, INNER.faces[~patch]), Surface(INNER.vertices, INNER.faces[patch])
    assert (holes([kept, OUTER], [removed], rays).surface == -1).all()
    open_cloth = Surface(OUTER.vertices, OUTER.faces[~patch])
    missed = holes([kept, open_cloth], [removed], rays)
    whole = look([INNER, open_cloth], rays)
    expected = (whole.surface == 0) & whole.facing & np.isin(whole.face, np.flatnonzero(patch))
    assert expected.sum() > 50
    np.testing.assert_array_equal(missed.surface == 0, expected)


def test_an_outline_that_is_slimmer_is_no_hole():
    """Without the outer tube the inner one is all there is: 6 mm slimmer, and whole but for its rims."""
    rays = camera_rays(OUTER.vertices)
    missed = holes([INNER], [OUTER], rays).surface == 0
    beside = look([OUTER], rays)
    slimmer = beside.facing & (look([INNER], rays).surface == -1)
    at_rim = np.isin(OUTER.vertices[OUTER.faces][..., 2], (HEIGHT.min(), HEIGHT.max())).any(axis=1)
    assert (slimmer & ~at_rim[beside.face]).sum() > 500
    assert not (missed & ~at_rim[beside.face]).any()


def test_names_of_outfits():
    assert [(g.model.name, g.tucked) for g in parse_outfit("tshirt:tucked,trousers")] == [
        ("tshirt", True),
        ("trousers", False),
    ]
    for text, message in {
        "tshirt": "at least two garments, got 1",
        "tshirt:in,trousers": "unknown fabric 'in'",
        "tshirt,": "",
    }.items():
        with pytest.raises(ValueError, match=message):
            parse_outfit(text)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "give one of MODEL and --outfit"),
        (["tshirt", "--outfit", "trousers,tshirt"], "give one of MODEL and --outfit"),
        (["--outfit", "trousers,tshirt", "--minimum", "4"], "--minimum is an option of MODEL, not of --outfit"),
        (["tshirt", "--stride", "9"], "--stride is an option of --outfit, not of MODEL"),
        (["--outfit", "trousers,tshirt", "--motion"], "at least one clip"),
        (["--outfit", "trousers,tshirt", "--motion", "dance", "--stride", "1"], "stride must be at least 5 frames"),
        (["--outfit", "trousers,tshirt", "--motion", "dance", "--bodies", "0"], "bodies must be 1 to"),
        (["--outfit", "trousers,tshirt", "--outfit", "trousers,tshirt"], "is given twice"),
    ],
)
def test_the_command_refuses_what_does_not_go_together(arguments, message, capsys):
    assert main([*arguments, "--device", "cpu"]) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: ") and message in error


def test_the_command_writes_all_figures(tmp_path, capsys):
    """Of two outfits in a moment of a shipped clip: order leaves next to nothing to see, at a small cost."""
    clip = load_motion("dance")
    arrays = ("positions", "root_orientation", "root_position")
    short = replace(clip, name="short", **{name: getattr(clip, name)[60:75] for name in arrays})
    save_motion(short, tmp_path / "short.safetensors")
    outfits = ["--outfit", "trousers,tshirt", "--outfit", "tshirt:tucked,trousers"]
    outputs = ["--motion", str(tmp_path / "short.safetensors"), "--json", str(tmp_path / "scores.json")]
    assert main([*outfits, *outputs, "--bodies", "1", "--stride", "10", "--device", "cpu"]) == 0
    scores = json.loads((tmp_path / "scores.json").read_text())
    assert scores["counts"] == {"bodies": 1, "clips": 1, "frames": 2, "stride": 10, "run": 5}
    assert set(scores["outfit"]) == {"trousers,tshirt", "tshirt:tucked,trousers"}
    table = capsys.readouterr().out
    for name, figures in scores["outfit"].items():
        assert f"| {name} " in table
        assert set(figures["clips"]) == {"short"} and FIGURES < set(figures)
        assert [set(counted) for counted in figures["pairs"].values()] == [FIGURES]
        assert set(figures["pairs"]) == {name.replace(":tucked", "")}
        assert figures["pixels"] > 1000 and figures["covered_vertices"] > 100
        assert figures["poke_percent"] < 10 and 0 <= figures["seen_poke_percent"] < 2
        assert 0 <= figures["skin_shows_percent"] < 10 and 0 < figures["hidden_vertices_percent"] < 30
        assert (
            0.9 < figures["added_jitter_ratio"] < 1.3 and -1 < figures["added_strain_points"] < 6
        )  # a loose hem is taken in
