"""Which cloth reaches the knees: by the bones that it follows, not by its name."""

import pytest

import physkin_core as physkin
from physkin_core.runtime.around_legs import reaches_knees


@pytest.mark.parametrize(
    ("shipped", "reaches"), [("tshirt", False), ("shorts", True), ("trousers", True), ("dress", True)]
)
def test_what_reaches_the_knees(shipped, reaches):
    model = physkin.load_garment_model(shipped)
    assert reaches_knees(model.rig, model.node_bone) == reaches
