"""Avatars that were modelled dressed: a body under their clothes, and garments that are made for it."""

import numpy as np
import pytest
from gltf_person import PERSON, SLEEVE, TRUNK, add_part, dressed_document, faces_on, load_document, person_document

from physkin_core import Draper, Outfit, load_garment_model
from physkin_core.check.sight import hole_percent
from physkin_core.quality import signed_distance

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")  # AvatarWarning, which `Avatar.warnings` keeps


def _off_skin(points):
    """[mm] from the person's true skin, positive outside."""
    return 1000 * signed_distance(points.astype(np.float64), PERSON.vertices.astype(np.float64), PERSON.faces)


@pytest.fixture(scope="module")
def dressed(tmp_path_factory):
    return load_document(tmp_path_factory.mktemp("dressed"), dressed_document(sleeves="long"))


def test_skin_stands_in_beneath_clothes(dressed):
    """A body where the person has it, not where sleeves stick out."""
    off = _off_skin(dressed.vertices)
    assert np.abs(off).mean() < 2.5 and off.max() < 1000 * SLEEVE / 3
    assert [len(piece.faces) > 0 for piece in dressed.clothes] == [True, True]
    assert max(_off_skin(piece.vertices).max() for piece in dressed.clothes) > 900 * SLEEVE
    assert "% of the body has clothes and no skin: the body model's stands in beneath them" in dressed.warnings[1]
    corners = np.unique(dressed.file_corners[len(dressed.faces) // 2 :])
    assert corners.min() >= 0 and len(dressed.file_corners) == len(dressed.faces)


def test_sleeves_that_stick_out_are_no_arms(dressed):
    """A T-shirt on the dressed person lies about where it does on the bare one."""
    model = load_garment_model("tshirt")
    on_dressed, on_bare = (Draper(model, body).drape(model.rig.rest)[:, :3] for body in (dressed, PERSON))
    apart = 1000 * np.linalg.norm(on_dressed - on_bare, axis=1)
    assert apart.mean() < 8 and apart.max() < 30  # 51 and 237 where sleeves are taken for arms


def test_the_stand_in_joins_the_skin(dressed):
    """No gap through which one sees into the body, at collar and cuffs, with the old clothes gone."""
    assert hole_percent(Outfit([load_garment_model("tshirt")], dressed, own_clothes="hide")) < 0.02


def test_skin_that_is_there_is_left_as_it_is(tmp_path):
    """Clothes over a whole skin add nothing to it."""
    avatar = load_document(tmp_path, dressed_document(skin_beneath=True))
    assert len(avatar.vertices) == len(PERSON.vertices) and len(avatar.warnings) == 1
    assert len(avatar.clothes) == 2


def test_skin_that_was_left_out_under_a_top_is_filled(tmp_path):
    """VRoid's chest: no hole in sight when the top is gone."""
    centres = PERSON.vertices[PERSON.faces].mean(axis=1)
    chest = (np.abs(centres[:, 2] - 0.22) < 0.16) & (np.abs(centres[:, 1]) < 0.13)
    builder = person_document(faces=PERSON.faces[~chest])
    add_part(builder, "Tops_01_CLOTH", faces_on(*TRUNK), offset=0.012)
    avatar = load_document(tmp_path, builder)
    outfit = Outfit([load_garment_model("trousers")], avatar, own_clothes="hide")
    assert outfit.avatar.clothes == () and hole_percent(outfit) < 0.05
