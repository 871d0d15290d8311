"""Which files may be used while the node runs, and what is loaded only once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from avatar_settings import garment_settings

from physkin_core import BUNDLED_AVATAR, made_of
from physkin_ros.node import asset_loading
from physkin_ros.node.asset_loading import AssetError, AssetRoots, OutfitLoader


def load(loader, garments, body="", *, hide=True):
    """What a loader makes of models or garments' settings."""
    garments = [garment_settings(model=each) if isinstance(each, str) else each for each in garments]
    return loader.load(garments, str(body), "", hide=hide)


def test_only_below_the_roots(tmp_path):
    """Links and dots are followed first; shipped garments and the bundled avatar are always allowed."""
    inside, outside = tmp_path / "inside", tmp_path / "outside"
    for folder in (inside, outside):
        folder.mkdir()
        (folder / "body.glb").write_bytes(b"x")
    (inside / "link.glb").symlink_to(outside / "body.glb")
    roots = AssetRoots([str(inside)], [str(outside / "body.glb")])
    roots.check_garment("tshirt")
    roots.check_garment("tshirt:denim")
    roots.check_body("", "")
    roots.check_body(str(BUNDLED_AVATAR), str(inside / "body.glb"))
    for path in (outside / "body.glb", inside / "link.glb", inside / ".." / "outside" / "body.glb", tmp_path):
        for check in (roots.check_body, roots.check_garment, lambda rig: roots.check_body("", rig)):
            with pytest.raises(AssetError, match=f"outside the parameter asset_roots; allowed: {inside}"):
                check(str(path))
    with pytest.raises(AssetError, match="no such file"):
        roots.check_body(str(inside / "none.glb"))
    with pytest.raises(ValueError, match="no fabric 'velvet'"):
        roots.check_garment("tshirt:velvet")


def test_default_roots_are_the_folders_of_the_start(tmp_path):
    """Without any file, nothing from the disk is allowed."""
    (tmp_path / "body.glb").write_bytes(b"x")
    AssetRoots([""], ["", str(tmp_path / "other.glb")]).check_body(str(tmp_path / "body.glb"))
    with pytest.raises(AssetError, match="nothing but shipped garments and the bundled avatar"):
        AssetRoots([""], ["", ""]).check_body(str(tmp_path / "body.glb"))


def test_large_files_are_not_opened(tmp_path, monkeypatch):
    monkeypatch.setattr(asset_loading, "LARGEST_ASSET", 3)
    (tmp_path / "body.glb").write_bytes(b"1234")
    with pytest.raises(AssetError, match="has 4 bytes; at most 3 are read"):
        AssetRoots([str(tmp_path)], []).check_body(str(tmp_path / "body.glb"))


def test_shipped_names_win_over_the_working_folder(tmp_path, model_path, monkeypatch):
    """A file of that name there is not opened; nor is one without a folder that lies outside the roots."""
    monkeypatch.chdir(tmp_path)
    for name in ("tshirt", "kilt", "kilt.safetensors"):
        (tmp_path / name).write_bytes(model_path.read_bytes())
    roots = AssetRoots([str(model_path.parent)], [])
    roots.check_garment("tshirt")
    (loaded,) = load(OutfitLoader(), ["tshirt"])
    assert loaded.layer.name == "tshirt"
    for name in ("kilt", "kilt.safetensors", "./tshirt"):
        with pytest.raises(AssetError, match=name):
            roots.check_garment(name)


def test_outfits_are_kept_by_content(tmp_path, model_path):
    """The same body under another name is another outfit of what is known of it; a changed file under the same name is
    not what was known. Clouds are the same."""
    loader = OutfitLoader()
    body, copy = tmp_path / "body.glb", tmp_path / "copy.glb"
    for path in (body, copy):
        path.write_bytes(BUNDLED_AVATAR.read_bytes())
    (first,), (again,), (renamed,) = (load(loader, [str(model_path)], path) for path in (body, body, copy))
    assert (first.cached, again.cached) == (False, True) and again.seconds < first.seconds
    assert again.layer is first.layer and first.outfit.avatar.source == str(body)
    assert renamed.outfit.avatar.source == str(copy)
    rest = first.layer.model.rig.rest
    np.testing.assert_array_equal(first.outfit.drape(rest), renamed.outfit.drape(rest))
    body.write_bytes(BUNDLED_AVATAR.read_bytes() + b"\0" * 4)
    assert not load(loader, [str(model_path)], body)[0].cached


def test_fits_and_fabrics_are_kept_apart(model_path):
    """Made to measure is the default, and known as fit 1; one size is another binding, as is another cloth."""
    loader = OutfitLoader()
    loads = [load(loader, [garment_settings(model=str(model_path), fit=fit)])[0] for fit in (None, 1.0, 0.0, None)]
    assert [each.cached for each in loads] == [False, True, False, True]
    assert [each.layer.fit for each in loads] == [1.0, 1.0, 0.0, 1.0]
    first, _, one_size, again = (each.layer.rest_garment.vertices for each in loads)
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - one_size).max() > 1e-3
    (denim,) = load(loader, [f"{model_path}:denim"])
    assert not denim.cached and denim.layer.model.material == made_of(loads[0].layer.model, "denim").material


def test_only_so_many_are_kept(model_path, monkeypatch):
    """The one that was used longest ago goes first."""
    monkeypatch.setattr(asset_loading, "KEPT", 1)
    loader, one, two = OutfitLoader(), str(model_path), "tshirt"
    assert [load(loader, [wanted])[0].cached for wanted in (one, one, two, one)] == [False, True, False, False]


def test_outfits_are_kept_and_shared_by_twins():
    """What is known is put on at once, with frames of its own; order, tucks and what is hidden make another one."""
    loader, shirt = OutfitLoader(), garment_settings(model="tshirt")
    first, again = (load(loader, ["trousers", shirt]) for _ in range(2))
    assert [each.cached for each in (*first, *again)] == [False, False, True, True]
    assert first[0].outfit is first[1].outfit is not again[0].outfit
    assert again[1].layer is first[1].layer and again[1].seconds < first[1].seconds
    assert [each.layer.name for each in first] == ["trousers", "tshirt"] and [each.index for each in first] == [0, 1]
    for others, hide in ((["trousers", shirt], False), ([replace(shirt, tucked=True), "trousers"], True)):
        assert not load(loader, others, hide=hide)[0].cached
    with pytest.raises(ValueError, match="'trousers' is there 2 times"):
        load(loader, ["trousers", "trousers"])
