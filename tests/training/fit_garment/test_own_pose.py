"""Garments that lie on an avatar in its own pose: a straight-armed body of the body model, whose skeleton is known."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from gltf_person import load_document, person_document
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from training.small_runs import mesh_of, write_belly_band

from physkin_core import Garment, load_body_model, load_garment
from physkin_core.avatar.avatar import AvatarError, avatar_from_body
from physkin_core.avatar.loading import load_avatar
from physkin_core.cli import main
from physkin_core.rig.canonical_pose import LIMB_SEGMENTS, limb_rotations, turned_down_the_chain
from physkin_core.rig.linear_blend_skinning import dense_weights, linear_blend_skinning
from physkin_training.contact.surface_queries import BodySurface
from physkin_training.fit_garment.checks import check_garment
from physkin_training.fit_garment.fitting import onto_body
from physkin_training.fit_garment.own_pose import OwnPose
from physkin_training.fit_garment.placement import find_lying

GARMENTS = Path(__file__).parents[3] / "training" / "garments"
BODY = load_body_model()
RIG = BODY.rig
Y_UP = np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]])
FLOOR = 0.85
"""[m] height of the root in the avatar's file."""
CLEAR = 0.0025
"""[m] garments lie this far from the avatar's skin at least."""


class Person:
    """A body of another shape than the garments', in a T-pose: what its file holds, and the bones' true transforms."""

    def __init__(self) -> None:
        self.canonical = avatar_from_body(BODY, BODY.held_out_bodies[5])
        heads = dict(zip(RIG.bone_names, self.canonical.bone_heads.astype(float)))
        straight = dict(heads)
        for start, end in LIMB_SEGMENTS.values():
            if "arm" in start:
                side = 1.0 if start.endswith("L") else -1.0
                straight[end] = straight[start] + np.array([0.0, side, 0.0])
        turns = {RIG.bone_index(name): turn for name, turn in limb_rotations(heads, straight).items()}
        arguments = self.canonical.bone_heads.astype(float), RIG.parents, turns
        self.transforms, self.heads = turned_down_the_chain(*arguments)
        skin = self.canonical.influence_bones, self.canonical.influence_weights
        self.vertices = linear_blend_skinning(self.canonical.vertices.astype(float), self.transforms, *skin)
        self.weights = dense_weights(*skin, RIG.bone_count)
        self.surface = BodySurface(self.vertices, self.canonical.faces)

    def write(self, path: Path) -> None:
        """The body with its feet about on the floor, and its rig file beside it."""
        up = np.array([0.0, 0.0, FLOOR])
        faces = self.canonical.faces
        trimesh.Trimesh(self.vertices + up, faces, process=False).export(path, digits=7)
        tails = np.einsum("bij,bj->bi", self.transforms[..., :3], self.canonical.bone_tails) + self.transforms[..., 3]
        bones = [
            {"name": name, "parent": int(parent), "head": (head + up).tolist(), "tail": (tail + up).tolist()}
            for name, parent, head, tail in zip(RIG.bone_names, RIG.parents, self.heads, tails)
        ]
        weights = {
            "influence_bones": self.canonical.influence_bones.tolist(),
            "influence_weights": self.canonical.influence_weights.tolist(),
        }
        path.with_suffix(".rig.json").write_text(json.dumps({"bones": bones, **weights}))

    def wearing(self, garment: Garment, template) -> tuple[np.ndarray, np.ndarray]:
        """A garment where it lies on the posed body, vertices (n, 3) [m] in the file's frame, and faces."""
        on_body = onto_body(garment.vertices, template, self.canonical)
        near = self.weights[cKDTree(self.canonical.vertices).query(on_body, k=16)[1]].mean(axis=1)
        blended = np.einsum("nb,bij->nij", near, self.transforms)
        posed = np.einsum("nij,nj->ni", blended[..., :3], on_body) + blended[..., 3]
        return self.surface.push_out(posed, CLEAR) + [0, 0, FLOOR], garment.faces

    def back(self, lying: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Of vertices (n, 3) in the file's frame: which lie on one bone's skin alone, and where the canonical pose has
        those."""
        posed = lying - [0, 0, FLOOR]
        near = self.weights[cKDTree(self.vertices).query(posed, k=64)[1]]
        still = np.stack([self.transforms[RIG.bone_index(name)] for name in RIG.bone_names])
        alike = np.einsum("nkb,bi->nki", near, still.reshape(len(still), -1))
        alone = np.ptp(alike, axis=1).max(axis=1) < 1e-3
        mean = alike[alone].mean(axis=1).reshape(-1, 3, 4)
        return alone, np.linalg.solve(mean[..., :3], (posed[alone] - mean[..., 3])[..., None])[..., 0]


@pytest.fixture(scope="module")
def person():
    return Person()


@pytest.fixture(scope="module")
def avatar_file(person, tmp_path_factory):
    path = tmp_path_factory.mktemp("avatar") / "person.obj"
    person.write(path)
    return path


@pytest.fixture(scope="module")
def own(avatar_file):
    """The avatar as loaded, and in the pose of its file."""
    avatar = load_avatar(avatar_file, RIG)
    return avatar, OwnPose.of(avatar, avatar.file_vertices, RIG)


@pytest.mark.parametrize(
    ("name", "scale", "axes", "read"),
    [
        ("longsleeve", 1.0, np.eye(3), "metres, Z up, X forward"),
        ("skirt", 0.01, Y_UP, "centimetres, Y up, Z forward"),
        ("trousers", 0.01, np.eye(3), "centimetres, Z up, X forward"),
    ],
)
def test_a_garment_is_where_it_lies(name, scale, axes, read, person, own, template):
    """Within 2 mm of where the true skeleton carries it into the canonical pose; the sleeves by far more than that."""
    lying, faces = person.wearing(load_garment(GARMENTS / f"{name}.obj"), template)
    avatar, pose = own
    placed = find_lying(lying @ axes.T / scale, pose, BodySurface(pose.vertices, pose.faces))
    assert [f"{reading.unit}, {reading.axes}" for reading in placed] == [read]
    there = placed[0].applied(lying @ axes.T / scale)
    assert np.linalg.norm(there - (lying - [0, 0, FLOOR]), axis=1).mean() < 1e-3
    alone, expected = person.back(lying)
    assert alone.mean() > 0.3
    error = np.linalg.norm(pose.canonical(there, faces)[alone] - expected, axis=1)
    assert error.mean() < 0.002
    if name == "longsleeve":
        assert np.linalg.norm(there[alone] - expected, axis=1).max() > 0.2


@pytest.mark.slow
def test_the_command_takes_it_as_it_lies(person, avatar_file, template, tmp_path, capsys, no_pictures):
    """A band about the belly is checked and written on the template; beside the avatar it is placed, but not trained
    unasked."""
    write_belly_band(tmp_path / "band.obj")
    made = load_garment(tmp_path / "band.obj")
    made = replace(made, vertices=made.vertices + [0.01, 0, 0])  # the belly's middle, towards which it would slide
    lying, faces = person.wearing(made, template)
    trimesh.Trimesh(100 * lying, faces, process=False).export(tmp_path / "band.obj", digits=7)
    command = ["fit-garment", "--avatar", str(avatar_file), "--check-only", "--device", "cpu"]
    output = tmp_path / "out.safetensors"
    assert main([*command, str(tmp_path / "band.obj"), "-o", str(output)]) == 0
    printed = capsys.readouterr().out
    assert re.search("^ok: .*position", printed, re.MULTILINE) and "repaired: units: centimetres" in printed
    worn = load_garment(tmp_path / "out" / "garment.obj")
    assert np.abs(worn.vertices.mean(axis=0) - made.vertices.mean(axis=0)).max() < 0.02
    trimesh.Trimesh(lying + [0, 0.6, 0], faces, process=False).export(tmp_path / "beside.obj", digits=7)
    beside = [*command, str(tmp_path / "beside.obj"), "-o", str(output)]
    (tmp_path / "out" / "garment.obj").unlink()
    assert main(beside) == 1
    told = capsys.readouterr()
    assert "position is in doubt: not on the avatar as it lies" in told.err
    assert "edge length" in told.out and "overlap" not in told.out, "what takes minutes waits for --accept-placement"
    assert not (tmp_path / "out" / "garment.obj").exists()
    assert main([*beside, "--accept-placement"]) == 0
    assert (tmp_path / "out" / "garment.obj").exists()


def test_a_glb_has_its_own_pose(tmp_path):
    """In the file's frame: Y up, forward Z."""
    avatar = load_document(tmp_path, person_document())
    pose = OwnPose.of(avatar, avatar.file_vertices, RIG)
    np.testing.assert_allclose(pose.vertices, avatar.vertices, atol=1e-4)
    np.testing.assert_allclose(pose.turn, Y_UP.T, atol=1e-5)
    assert pose.scale == pytest.approx(1.0, abs=1e-5)


def test_another_pose_than_limbs_can_take_is_an_error(own):
    avatar, pose = own
    bent = avatar.vertices @ Rotation.from_euler("x", 0.5).as_matrix().T
    head = avatar.vertices[:, 2:] > 0.4
    with pytest.raises(AvatarError, match="mm from the canonical one"):
        OwnPose.of(avatar, np.where(head, bent, avatar.vertices), RIG)


def upside_down(v, f):
    middle = (v.min(axis=0) + v.max(axis=0)) / 2
    return (v - middle) * [1, -1, -1] + middle, f


def a_tenth_gone(v, f):
    return v, f[np.random.default_rng(0).random(len(f)) > 0.1]


def a_patch_gone(v, f):
    """Out of the back."""
    away = np.linalg.norm(v[f].mean(axis=1) - [-0.1, 0.0, 0.3], axis=1)
    return v, f[away > np.quantile(away, 0.1)]


LIKE_OTHERS = [pytest.param(name, marks=pytest.mark.slow) for name in ("dress", "trousers", "circleskirt")]


@pytest.mark.parametrize("name", ["tshirt", "skirt", *LIKE_OTHERS])
def test_upside_down_is_refused(name, template):
    """Where it is put on all the same, as without an avatar."""
    garment = load_garment(GARMENTS / f"{name}.obj")
    checked = check_garment(mesh_of(*upside_down(garment.vertices, garment.faces)), template, template)
    assert checked.refused and checked.verdicts[-1].check in ("upright", "position")


@pytest.mark.parametrize("spoil", [a_tenth_gone, a_patch_gone])
def test_missing_faces_are_refused(spoil, template):
    garment = load_garment(GARMENTS / "tshirt.obj")
    last = check_garment(mesh_of(*spoil(garment.vertices, garment.faces)), template, template).verdicts[-1]
    assert (last.check, last.outcome) == ("openings", "refused") and "faces are missing" in last.found
