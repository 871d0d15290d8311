"""Names of the last release are refused by a sentence that gives the new one."""

from inspect import signature

import pytest

import physkin_core
from physkin_core import BoneRotations, FrameInput, Garment, Layer, Outfit
from physkin_core.cli import main
from physkin_core.renamed import ARGUMENTS, ATTRIBUTES, OPTIONS

OWNERS = {"physkin_core": physkin_core} | {
    owner.__name__: owner for owner in (BoneRotations, FrameInput, Garment, Layer, Outfit)
}


@pytest.mark.parametrize(("command", "old"), [(command, old) for command in OPTIONS for old in OPTIONS[command]])
def test_an_old_option_is_refused_by_naming_the_new_one(command, old, capsys):
    """Also as --option=value, before anything else is read."""
    for argument in (old, f"{old}=x"):
        assert main([command, argument]) == 2
        assert f"{old} of physkin {command} is now called {OPTIONS[command][old]}" in capsys.readouterr().err


@pytest.mark.parametrize(("owner", "old"), [(owner, old) for owner in ATTRIBUTES for old in ATTRIBUTES[owner]])
def test_an_old_attribute_is_refused_by_naming_the_new_one(owner, old):
    """Of the module and of classes; the new one exists."""
    new = ATTRIBUTES[owner][old]
    assert hasattr(OWNERS[owner], new) or new in getattr(OWNERS[owner], "__dataclass_fields__", ())
    with pytest.raises(AttributeError, match=f"{owner}.{old} is now called {new}"):
        getattr(OWNERS[owner], old)


@pytest.mark.parametrize(("owner", "old"), [(owner, old) for owner in ARGUMENTS for old in ARGUMENTS[owner]])
def test_an_old_argument_is_refused_by_naming_the_new_one(owner, old):
    """Of making an object; the new one exists."""
    new = ARGUMENTS[owner][old]
    assert new in signature(OWNERS[owner]).parameters
    with pytest.raises(TypeError, match=f"{old} of {owner} is now called {new}"):
        OWNERS[owner]([], None, **{old: False})


def test_a_name_that_never_was_is_missing_as_usual():
    """By the module's own sentence."""
    with pytest.raises(AttributeError, match="physkin_core.nosuch does not exist"):
        _ = physkin_core.nosuch
