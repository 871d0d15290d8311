"""What becomes of the clothes that an avatar wears already: in pictures; drapes do not know them."""

from functools import cache

import numpy as np
import pytest
from gltf_person import dressed_document, load_document

from physkin_core import Outfit, load_garment_model
from physkin_core.look.avatar_look import avatar_colours

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")  # AvatarWarning, which `Avatar.warnings` keeps
RED, BLUE = (0.6, 0.05, 0.05), (0.05, 0.07, 0.25)
"""Linear RGB of top and trousers."""


@pytest.fixture(scope="module")
def dressed(tmp_path_factory):
    return load_document(tmp_path_factory.mktemp("dressed"), dressed_document(sleeves="long"))


@pytest.fixture(scope="module")
def wearing(dressed):
    """Outfits of one garment on the dressed avatar, each bound once."""
    return cache(
        lambda name, own_clothes="replace": Outfit([load_garment_model(name)], dressed, own_clothes=own_clothes)
    )


def _seen(outfit, colour):
    """How many faces of a colour are drawn."""
    return int((np.abs(avatar_colours(outfit.body_to_draw) - np.power(colour, 1 / 2.2)) < 0.02).all(axis=1).sum())


def test_a_shirt_replaces_a_shirt(dressed, wearing):
    """Trousers stay; hidden, nothing does; kept, sleeves reach out of the T-shirt, and nothing lies under it."""
    outfits = {way: wearing("tshirt", way) for way in ("replace", "hide", "keep")}
    red, blue = ({way: _seen(outfit, colour) for way, outfit in outfits.items()} for colour in (RED, BLUE))
    top, trousers = (len(piece.faces) for piece in dressed.clothes)
    assert red["replace"] == red["hide"] == blue["hide"] == 0
    assert 0.1 * top < red["keep"] < 0.7 * top
    assert 0.8 * trousers < blue["replace"] == blue["keep"] <= trousers
    draped = [outfit.drape({})[0] for outfit in outfits.values()]
    np.testing.assert_array_equal(draped[0], draped[1])
    np.testing.assert_array_equal(draped[0], draped[2])


def test_trousers_replace_trousers(wearing):
    outfit = wearing("trousers")
    assert _seen(outfit, BLUE) == 0 and _seen(outfit, RED) > 0


def test_skin_is_drawn_slimmer_under_what_stays(dressed, wearing):
    """Up to 6 mm under the trousers; face and hands are drawn as they are."""
    drawn = wearing("tshirt", "replace").body_to_draw.vertices[: len(dressed.vertices)]
    moved = 1000 * np.linalg.norm(drawn - dressed.vertices, axis=1)
    height = dressed.vertices[:, 2]
    assert moved[(height < -0.2) & (height > -0.5)].mean() > 3 and moved.max() < 6.1
    assert moved[height > 0.55].max() == 0


def test_another_way_is_refused(wearing):
    with pytest.raises(ValueError, match="own_clothes is 'burn'; allowed: replace, hide, keep"):
        wearing("tshirt", "burn")
