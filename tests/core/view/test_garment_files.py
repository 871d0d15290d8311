"""Garments are put on again when their files are written anew."""

from __future__ import annotations

import os
import shutil
from threading import Event
from types import SimpleNamespace

import pytest

from physkin_core.model.model_file import MODELS_PATH
from physkin_core.view import garment_files
from physkin_core.view.garment_files import follow_files


class State(SimpleNamespace):
    """Notes what is worn; "broken" cannot be."""

    def wear(self, garments, *, tucked):
        self.worn.append((tuple(garments), frozenset(tucked)))
        if self.broken:
            raise ValueError("broken")


@pytest.fixture
def own(tmp_path, monkeypatch):
    monkeypatch.setattr(garment_files, "LOOK_EVERY", 0.01)
    path = tmp_path / "own.safetensors"
    shutil.copy(MODELS_PATH / "tanktop.safetensors", path)
    return path


def written_anew(path):
    os.utime(path, ns=(0, path.stat().st_mtime_ns + 1_000_000))


def test_what_was_written_anew_is_worn(own):
    """In the same outfit, tucked as before; a shipped name is no file; an error is told, and looking goes on."""
    state = State(garments=("trousers", f"{own}:denim"), tucked=frozenset(["trousers"]), worn=[], broken=False)
    told, heard = [], Event()
    end = follow_files(state, lambda error: (told.append(error), heard.set()))
    try:
        assert not state.worn
        written_anew(own)
        assert heard.wait(5) and told == [None]
        assert state.worn == [(state.garments, state.tucked)]
        heard.clear()
        state.broken = True
        written_anew(own)
        assert heard.wait(5) and str(told[1]) == "broken"
        heard.clear()
        own.unlink()
        assert not heard.wait(0.1), "a file that is gone is no new one"
    finally:
        end()
