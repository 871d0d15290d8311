"""Garments that options ask for."""

import pytest

from physkin_core.outfit.outfit_options import chosen_garments


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
