"""Which files may be used while the node runs, and what is loaded only once."""

from __future__ import annotations

import numpy as np
import pytest
from avatar_settings import avatar_settings, garment_settings

from physkin_core import BUNDLED_AVATAR, Draper, load_avatar, load_garment_model, with_fabric
from physkin_ros.node import asset_loading
from physkin_ros.node.asset_loading import AssetError, AssetRoots


def load(loader, *garments, hide_covered=True):
    """What a loader makes of models or garments' settings."""
    settings = (garment_settings(model=each) if isinstance(each, str) else each for each in garments)
    return loader.load(avatar_settings(garments=tuple(settings), hide_covered=hide_covered))


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
    for allowed in ("", str(BUNDLED_AVATAR), str(inside / "body.glb")):
        roots.check_body(allowed)
    for path in (outside / "body.glb", inside / "link.glb", inside / ".." / "outside" / "body.glb", tmp_path):
        for check in (roots.check_body, roots.check_garment):
            with pytest.raises(AssetError, match=f"outside the parameter asset_roots; allowed: {inside}"):
                check(str(path))
    with pytest.raises(AssetError, match="no such file"):
        roots.check_body(str(inside / "none.glb"))
    (inside / "circle.glb").symlink_to(inside / "circle.glb")
    with pytest.raises(AssetError, match=r"circle.glb: (its links form a loop|no such file)"):
        roots.check_body(str(inside / "circle.glb"))
    with pytest.raises(ValueError, match="unknown fabric 'velvet'"):
        roots.check_garment("tshirt:velvet")


def test_default_roots_are_the_folders_of_the_start(tmp_path):
    """Without any file, nothing from the disk is allowed."""
    (tmp_path / "body.glb").write_bytes(b"x")
    AssetRoots([""], ["", str(tmp_path / "other.glb")]).check_body(str(tmp_path / "body.glb"))
    with pytest.raises(AssetError, match="nothing but shipped garments and the bundled avatar"):
        AssetRoots([""], ["", ""]).check_body(str(tmp_path / "body.glb"))


def test_large_files_are_not_opened(tmp_path, monkeypatch):
    monkeypatch.setattr(asset_loading, "LARGEST_FILE", 3)
    (tmp_path / "body.glb").write_bytes(b"1234")
    with pytest.raises(AssetError, match="has 4 bytes; at most 3 are read"):
        AssetRoots([str(tmp_path)], []).check_body(str(tmp_path / "body.glb"))


def test_shipped_names_win_over_the_working_folder(outfit_loader, tmp_path, model_path, monkeypatch):
    """A file of that name there is not opened; nor is one without a folder that lies outside the roots."""
    monkeypatch.chdir(tmp_path)
    for name in ("tshirt", "kilt", "kilt.safetensors"):
        (tmp_path / name).write_bytes(model_path.read_bytes())
    roots = AssetRoots([str(model_path.parent)], [])
    roots.check_garment("tshirt")
    assert load(outfit_loader, "tshirt").outfit.layers[0].name == "tshirt"
    for name in ("kilt", "kilt.safetensors", "./tshirt"):
        with pytest.raises(AssetError, match=name):
            roots.check_garment(name)


def test_fits_and_fabrics_are_kept_apart(outfit_loader, model_path):
    """Made to measure is the default, and known as fit 1; one size is another binding, as is another cloth."""
    loads = [load(outfit_loader, garment_settings(model=str(model_path), fit=fit)) for fit in (None, 1.0, 0.0)]
    layers = [each.outfit.layers[0] for each in loads]
    assert loads[1].cached and [each.fit for each in layers] == [1.0, 1.0, 0.0]
    first, again, one_size = (each.rest_garment.vertices for each in layers)
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - one_size).max() > 1e-3
    denim = load(outfit_loader, f"{model_path}:denim").outfit
    wanted = Draper(with_fabric(load_garment_model(model_path), "denim"), load_avatar(BUNDLED_AVATAR, denim.rig))
    np.testing.assert_array_equal(denim.drape(denim.rig.rest)[0], wanted.drape(denim.rig.rest))


def test_outfits_are_kept_and_shared_by_twins(outfit_loader, model_path, swaying_model_path):
    """What is known is put on at once, with frames of its own."""
    vest, swaying = str(model_path), str(swaying_model_path)
    first, again = (load(outfit_loader, vest, swaying, hide_covered=False) for _ in range(2))
    assert again.cached and first.outfit is not again.outfit
    assert again.outfit.layers[1] is first.outfit.layers[1]
    assert [each.name for each in first.outfit.layers] == ["vest", "swaying"]
    with pytest.raises(ValueError, match="'vest' is there 2 times"):
        load(outfit_loader, vest, vest)
