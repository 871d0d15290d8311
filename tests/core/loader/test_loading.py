"""What the process that loads does, in this one: what it keeps, and what it refuses."""

from __future__ import annotations

import pytest

from physkin_core import BUNDLED_AVATAR
from physkin_core.loader import loading
from physkin_core.loader.loading import Loading
from physkin_core.loader.requests import GarmentRequest, OutfitRequest

pytestmark = pytest.mark.filterwarnings("ignore::physkin_core.AvatarWarning")


@pytest.fixture
def wanted(tmp_path, model_path):
    """The test's garment on a body of its own."""
    body = tmp_path / "body.glb"
    body.write_bytes(BUNDLED_AVATAR.read_bytes())
    return OutfitRequest((GarmentRequest(str(model_path)),), str(body))


def test_a_body_that_changes_while_it_is_read_is_not_kept(wanted, monkeypatch):
    """It is refused: what was read belongs to neither content."""
    load, loads = loading.load_avatar, []

    def meanwhile(path, *more, **options):
        avatar = load(path, *more, **options)
        if not loads:
            path.write_bytes(BUNDLED_AVATAR.read_bytes() + b"\0" * 4)
        loads.append(path)
        return avatar

    monkeypatch.setattr(loading, "load_avatar", meanwhile)
    answers = Loading()
    with pytest.raises(ValueError, match=r"body\.glb changed while it was read; load it again"):
        answers(wanted)
    assert not answers(wanted).cached and len(loads) == 2
    assert answers(wanted).cached and len(loads) == 2


def test_what_is_kept_is_limited_in_bytes(wanted, monkeypatch):
    """Models, avatars and outfits together."""
    monkeypatch.setattr(loading, "KEPT_BYTES", 1000)
    answers = Loading()
    assert [answers(wanted).cached for _ in range(2)] == [False, False]


def test_what_is_worn_otherwise_does_not_read_the_body_again(wanted, monkeypatch):
    answers, load, loads = Loading(), loading.load_avatar, []
    monkeypatch.setattr(loading, "load_avatar", lambda *given, **options: loads.append(1) or load(*given, **options))
    for fit in (None, 0.0, None):
        answers(OutfitRequest((GarmentRequest(wanted.garments[0].model, fit=fit),), wanted.body))
    assert len(loads) == 1
