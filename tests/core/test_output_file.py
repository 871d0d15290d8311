"""Where a file cannot be written is told before the work."""

from __future__ import annotations

import os

import pytest

from physkin_core.output_file import check_folder, check_other_file


def test_folders(tmp_path, monkeypatch):
    """One that is missing, one that is read-only, and a folder in the file's place."""
    check_folder(tmp_path / "a.png")
    with pytest.raises(ValueError, match="none/a.png: there is no folder .*none"):
        check_folder(tmp_path / "none" / "a.png")
    with pytest.raises(ValueError, match="it is a folder"):
        check_folder(tmp_path)
    monkeypatch.setattr(os, "access", lambda path, mode: False)  # tests may run as root, who may write anywhere
    with pytest.raises(ValueError, match="a.png: the folder .* is read-only for this user"):
        check_folder(tmp_path / "a.png")


def test_what_is_read_is_not_written(tmp_path):
    """By any of its names; files that are not there, and shipped names, are no obstacle."""
    mine, link = tmp_path / "me.glb", tmp_path / "link.glb"
    check_other_file(mine, mine, "walk")
    mine.write_bytes(b"x")
    link.symlink_to(mine)
    check_other_file(mine, "walk", tmp_path / "other.glb")
    with pytest.raises(ValueError, match="link.glb: it is the file that is read; give another name"):
        check_other_file(link, "walk", mine)
