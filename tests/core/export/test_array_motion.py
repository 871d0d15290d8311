"""Arrays of a draped motion: as a reader of Zarr has them, written past the system's cache or through it."""

from __future__ import annotations

import errno
import os

import numpy as np
import pytest

from physkin_core import BUNDLED_AVATAR, Outfit, load_avatar, load_garment_model, load_motion
from physkin_core.cli import main
from physkin_core.export import array_motion
from physkin_core.export.array_motion import write_array_motion


@pytest.fixture(scope="module")
def outfit():
    """Two garments, the lower one covered in part."""
    models = [load_garment_model(name) for name in ("trousers", "tshirt")]
    return Outfit(models, load_avatar(BUNDLED_AVATAR, models[0].rig))


@pytest.fixture(scope="module")
def motion():
    """More than two chunks, the last of which is not full."""
    return load_motion("walk").looped(2.5)


def contents(folder):
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_every_vertex_in_every_frame(outfit, motion, tmp_path):
    """Of both garments; chunks are equally long, and a second motion through the same memory leaves nothing behind."""
    zarr = pytest.importorskip("zarr", reason="needs the [cluster] extra")
    assert write_array_motion(tmp_path / "a.zarr", outfit, motion) == []
    write_array_motion(tmp_path / "short.zarr", outfit, motion.looped(0.1))
    group = zarr.open_group(tmp_path / "a.zarr", mode="r")
    assert group.attrs["garments"] == ["trousers", "tshirt"] and group.attrs["rate_hz"] == motion.rate_hz
    outfit.reset()
    for frame, (joints, time, root) in enumerate(zip(motion.positions_for(outfit.rig), motion.times, motion.root)):
        clouds = outfit.drape(joints, time=time, root=root)
        if frame in (0, 49, 50, 149):
            for layer, cloud in zip(outfit.layers, clouds):
                np.testing.assert_array_equal(group[f"{layer.name}/positions"][frame], cloud[:, :3])
                np.testing.assert_array_equal(group[f"{layer.name}/normals"][frame], cloud[:, 3:])
    for layer in outfit.layers:
        assert group[f"{layer.name}/positions"].chunks == (50, len(layer.visible), 3)
        np.testing.assert_array_equal(group[f"{layer.name}/vertex_ids"][:], layer.visible)
    chunk = tmp_path / "short.zarr" / "tshirt" / "normals" / "c.0.0.0"
    assert chunk.stat().st_size == 6 * len(outfit.layers[1].visible) * 12 and not chunk.stat().st_mode & 0o111


def test_what_cannot_be_written_directly_is_written_through_the_cache(outfit, motion, tmp_path, monkeypatch):
    """Some file systems refuse at once, others when they are given data."""
    write_array_motion(tmp_path / "direct.zarr", outfit, motion)
    opened, real = [], os.open

    def refusing(path, flags, mode=0o777):
        opened.append(path)
        if flags & array_motion.DIRECT:
            raise OSError(errno.EINVAL, os.strerror(errno.EINVAL), path)
        return real(path, flags, mode)

    monkeypatch.setattr(array_motion.os, "open", refusing)
    write_array_motion(tmp_path / "cached.zarr", outfit, motion)
    assert opened and contents(tmp_path / "cached.zarr") == contents(tmp_path / "direct.zarr")
    monkeypatch.setattr(array_motion, "DIRECT", 0)
    write_array_motion(tmp_path / "none.zarr", outfit, motion)
    assert contents(tmp_path / "none.zarr") == contents(tmp_path / "direct.zarr")


def test_a_full_disk_is_an_error(outfit, motion, tmp_path, monkeypatch):
    def full(path, flags, mode=0o777):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), path)

    monkeypatch.setattr(array_motion.os, "open", full)
    with pytest.raises(OSError, match="No space left on device"):
        write_array_motion(tmp_path / "a.zarr", outfit, motion)


def test_arrays_are_written_anew_and_nothing_else_is_lost(tmp_path, capsys):
    """The command needs nothing that a plain installation lacks."""
    path = tmp_path / "a.zarr"
    for frames in (1.0, 0.5):
        assert main(["export", "kick", "-o", str(path), "--rate", str(10 * frames)]) == 0
    first = contents(path)
    assert main(["export", "kick", "-o", str(tmp_path / "b.zarr"), "--rate", "5"]) == 0
    assert contents(tmp_path / "b.zarr") == first
    other = tmp_path / "mine.zarr"
    other.mkdir()
    (other / "thesis.txt").write_text("all of it")
    capsys.readouterr()
    assert main(["export", "kick", "-o", str(other)]) == 2
    error = capsys.readouterr().err
    assert "mine.zarr: it is there, and no Zarr folder; give another name" in error and error.count("\n") == 1
    assert (other / "thesis.txt").read_text() == "all of it"
