"""The command that installs an extra: by this Python's pip, from where the package is from."""

from __future__ import annotations

import json
import sys
from importlib.metadata import PackageNotFoundError
from pathlib import Path
from types import SimpleNamespace

import pytest

from physkin_core import extras
from physkin_core.extras import install_command


@pytest.fixture
def installed(monkeypatch, tmp_path):
    """Makes the package one that pip has installed from somewhere; pip is on the PATH, the current folder a clone."""
    monkeypatch.setattr(extras.shutil, "which", lambda name: str(Path(sys.executable).parent / name))
    monkeypatch.chdir(tmp_path)

    def installed_from(origin: dict | None) -> None:
        text = None if origin is None else json.dumps(origin)
        monkeypatch.setattr(extras, "distribution", lambda name: SimpleNamespace(read_text=lambda file: text))

    return installed_from


@pytest.mark.parametrize(
    ("origin", "source"),
    [
        (None, "'physkin[view]'"),
        ({"url": "file:///opt/a%20b", "dir_info": {"editable": True}}, "--editable '/opt/a b[view]'"),
        ({"url": "file:///opt/physkin", "dir_info": {}}, "'/opt/physkin[view]'"),
        ({"url": "file:///opt/physkin-1.whl", "archive_info": {}}, "'physkin[view] @ file:///opt/physkin-1.whl'"),
        ({"url": "https://example.org/a", "vcs_info": {"vcs": "git"}}, "'physkin[view] @ git+https://example.org/a'"),
    ],
)
def test_source_is_where_the_package_is_from(installed, origin, source):
    """An index, a clone, a folder, a wheel, a repository."""
    installed(origin)
    assert install_command("view") == f"pip install {source}"


def test_in_a_clone_paths_are_short(installed, tmp_path):
    """Where its environment is not active, too: another pip would install for another Python."""
    installed({"url": tmp_path.as_uri(), "dir_info": {"editable": True}})
    assert install_command("ros", options="--upgrade") == "pip install --upgrade --editable '.[ros]'"
    assert install_command() == "pip install --editable '.'"


def test_another_pip_is_not_told(installed, monkeypatch):
    """The pip on the PATH is another Python's, or there is none."""
    installed(None)
    for found in ("/usr/bin/pip", None):
        monkeypatch.setattr(extras.shutil, "which", lambda name, found=found: found)
        assert install_command("view") == f"{sys.executable} -m pip install 'physkin[view]'"


def test_source_folder_has_no_origin(installed, monkeypatch):
    """As in a colcon workspace."""

    def absent(name):
        raise PackageNotFoundError(name)

    monkeypatch.setattr(extras, "distribution", absent)
    assert install_command("view") == "pip install 'physkin[view]'"
