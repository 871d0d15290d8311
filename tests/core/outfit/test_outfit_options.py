"""Garments that options ask for."""

import argparse

import pytest
from gltf_person import dressed_document

from physkin_core.formats.gltf_builder import write_glb
from physkin_core.outfit.outfit_options import add_outfit_options, chosen_garments, dressed


@pytest.mark.parametrize("tucked", ["tshirt", "tshirt:denim"])
def test_a_garment_of_another_fabric_is_tucked_by_either_name(tucked):
    """By the garment alone, or with the fabric as it is worn; the other garment is not tucked."""
    shirt, trousers = chosen_garments(["tshirt:denim", "trousers"], [tucked])
    assert shirt.tucked and not trousers.tucked
    assert shirt.model.material != chosen_garments(["tshirt"], [])[0].model.material


def test_a_fabric_that_is_not_worn_is_not_tucked():
    with pytest.raises(
        ValueError, match="--tucked tshirt:silk: none of the garments, which are tshirt:denim, trousers"
    ):
        chosen_garments(["tshirt:denim", "trousers"], ["tshirt:silk"])


@pytest.mark.filterwarnings("ignore::UserWarning")  # AvatarWarning, which is printed
def test_own_clothes_are_kept_when_asked_so(tmp_path, capsys):
    """The warning says what the avatar wears. By default what garments replace is gone."""
    write_glb(tmp_path / "me.glb", dressed_document())
    parser = argparse.ArgumentParser()
    add_outfit_options(parser)
    assert parser.parse_args([]).own_clothes == "replace"
    arguments = ["--avatar", str(tmp_path / "me.glb"), "-g", "tshirt", "--fit", "0", "--own-clothes", "keep"]
    assert len(dressed(parser.parse_args(arguments)).avatar.clothes) == 2
    assert "worn already: 'Wolf3D_Outfit_Top/Top', 'Wolf3D_Outfit_Bottom/Bottom'" in capsys.readouterr().err
