"""Which files may be used while the node runs, and what is loaded only once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from physkin_core import BUNDLED_AVATAR
from physkin_ros.node import asset_loading
from physkin_ros.node.asset_loading import AssetError, AssetRoots, DraperLoader, Outfitting

BUNDLED = Outfitting("tshirt", precision="fp32")


def test_only_below_the_roots(tmp_path):
    """Links and dots are followed first; shipped garments and the bundled avatar are always allowed."""
    inside, outside = tmp_path / "inside", tmp_path / "outside"
    for folder in (inside, outside):
        folder.mkdir()
        (folder / "body.glb").write_bytes(b"x")
    (inside / "link.glb").symlink_to(outside / "body.glb")
    roots = AssetRoots([str(inside)], [str(outside / "body.glb")])
    roots.check(str(inside / "body.glb"))
    BUNDLED.check(roots)
    replace(BUNDLED, body_mesh=str(BUNDLED_AVATAR)).check(roots)
    for path in (outside / "body.glb", inside / "link.glb", inside / ".." / "outside" / "body.glb", tmp_path):
        with pytest.raises(AssetError, match=f"outside the parameter asset_roots; allowed: {inside}"):
            replace(BUNDLED, body_mesh=str(path)).check(roots)
    for wrong in (replace(BUNDLED, model=str(outside / "x.safetensors")), replace(BUNDLED, body_rig="/etc/passwd")):
        with pytest.raises(AssetError, match="outside"):
            wrong.check(roots)
    with pytest.raises(AssetError, match="no such file"):
        roots.check(str(inside / "none.glb"))


def test_default_roots_are_the_folders_of_the_start(tmp_path):
    """Without any file, nothing from the disk is allowed."""
    (tmp_path / "body.glb").write_bytes(b"x")
    AssetRoots([""], ["", str(tmp_path / "other.glb")]).check(str(tmp_path / "body.glb"))
    with pytest.raises(AssetError, match="nothing but shipped garments and the bundled avatar"):
        AssetRoots([""], ["", ""]).check(str(tmp_path / "body.glb"))


def test_shipped_names_win_over_the_working_folder(tmp_path, model_path, monkeypatch):
    """A file of that name there is not opened; nor is one without a folder that lies outside the roots."""
    monkeypatch.chdir(tmp_path)
    for name in ("tshirt", "kilt", "kilt.safetensors"):
        (tmp_path / name).write_bytes(model_path.read_bytes())
    roots = AssetRoots([str(model_path.parent)], [])
    BUNDLED.check(roots)
    assert DraperLoader("native").load(BUNDLED).draper.model.name == "tshirt"
    for name in ("kilt", "kilt.safetensors", "./tshirt"):
        with pytest.raises(AssetError, match=name):
            Outfitting(name).check(roots)


def test_encodings_are_kept_by_content(tmp_path, model_path):
    """The same body under another name is known; a changed file under the same name is not. Clouds are the same."""
    loader = DraperLoader("native")
    body, copy = tmp_path / "body.glb", tmp_path / "copy.glb"
    for path in (body, copy):
        path.write_bytes(BUNDLED_AVATAR.read_bytes())
    wanted = Outfitting(str(model_path), str(body), precision="fp32")
    first = loader.load(wanted)
    again, renamed = loader.load(wanted), loader.load(replace(wanted, body_mesh=str(copy)))
    assert (first.cached, again.cached, renamed.cached) == (False, True, True)
    assert renamed.draper.avatar.source == str(copy)
    assert first.at_rest == first.draper.at_rest and again.at_rest is renamed.at_rest is first.at_rest
    rest = first.draper.model.rig.rest
    np.testing.assert_array_equal(first.draper.drape(rest), renamed.draper.drape(rest))
    body.write_bytes(BUNDLED_AVATAR.read_bytes() + b"\0" * 4)
    assert not loader.load(wanted).cached


def test_fits_are_kept_apart(model_path):
    """Made to measure is the default, and known as fit 1; one size is another binding."""
    loader, wanted = DraperLoader("native"), Outfitting(str(model_path))
    loads = [loader.load(replace(wanted, fit=fit)) for fit in (None, 1.0, 0.0, None)]
    assert [each.cached for each in loads] == [False, True, False, True]
    assert [each.draper.fit for each in loads] == [1.0, 1.0, 0.0, 1.0]
    first, _, one_size, again = (each.draper.rest_garment.vertices for each in loads)
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - one_size).max() > 1e-3


def test_only_so_many_are_kept(model_path, monkeypatch):
    """The one that was used longest ago goes first."""
    monkeypatch.setattr(asset_loading, "KEPT", 1)
    loader = DraperLoader("native")
    one, two = Outfitting(str(model_path), precision="fp32"), BUNDLED
    assert [loader.load(wanted).cached for wanted in (one, one, two, one)] == [False, True, False, False]


def test_outfits_are_kept_and_shared_by_twins():
    """What is known is put on at once, with frames of its own; order, tucks and what is hidden make another one."""
    loader = DraperLoader("native")
    shirt, legs = Outfitting("tshirt"), Outfitting("trousers")
    first = loader.load_outfit([legs, shirt], hide=True)
    again = loader.load_outfit([legs, shirt], hide=True)
    assert [each.cached for each in (*first, *again)] == [False, False, True, True]
    assert first[0].draper.outfit is first[1].draper.outfit is not again[0].draper.outfit
    assert again[1].draper.bound is first[1].draper.bound and again[1].seconds < first[1].seconds
    assert [each.draper.model.name for each in first] == ["trousers", "tshirt"]
    for others, hide in (([legs, shirt], False), ([replace(shirt, tucked=True), legs], True)):
        assert not loader.load_outfit(others, hide=hide)[0].cached
    with pytest.raises(ValueError, match="'trousers' is there 2 times"):
        loader.load_outfit([legs, legs], hide=True)
