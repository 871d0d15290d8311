"""What killed processes leave behind, told from what living ones use."""

from __future__ import annotations

import mmap

import pytest

from physkin_ros.middleware import shared_memory


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setattr(shared_memory, "SHARED_MEMORY", tmp_path)
    for name in ("fastrtps_aa", "fastrtps_aa_el", "fastrtps_bb", "sem.fastrtps_aa_mutex", "someone_elses"):
        (tmp_path / name).write_bytes(b"x" * 8)
    return tmp_path


def test_only_what_nobody_has_open(folder):
    """This process has one open: it stays, as does what is not Fast DDS's."""
    with open(folder / "fastrtps_bb", "r+b") as file, mmap.mmap(file.fileno(), 0):
        assert shared_memory.shared_memory_of("self") >= {"fastrtps_bb"}
        assert shared_memory.leftovers() == {"fastrtps_aa"}
        assert shared_memory.remove_shared_memory({"fastrtps_aa", "fastrtps_bb"}) == 24
    assert sorted(path.name for path in folder.iterdir()) == ["fastrtps_bb", "someone_elses"]
    assert shared_memory.leftovers() == {"fastrtps_bb"}
