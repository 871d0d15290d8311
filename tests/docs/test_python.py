"""Python in the documents runs as it stands there."""

import re
import shutil

import pytest
from documents import DOCUMENTS, name_of

import physkin_core
from import_graph import ROOT

BLOCK = re.compile(r"^```python\n(.*?)^```", flags=re.MULTILINE | re.DOTALL)
WITH_PYTHON = [path for path in DOCUMENTS if path.parent in (ROOT, ROOT / "docs") and BLOCK.search(path.read_text())]


@pytest.mark.filterwarnings("ignore::physkin_core.AvatarWarning")
@pytest.mark.parametrize("document", WITH_PYTHON, ids=name_of)
def test_blocks_run(document, shipped, tmp_path, monkeypatch):
    """One after the other, with a draper, a pose and a file as readers have them by then; not what reads a message."""
    shutil.copy(physkin_core.BUNDLED_AVATAR, tmp_path / "me.vrm")
    monkeypatch.chdir(tmp_path)
    model, blocks = shipped("tshirt"), [each for each in BLOCK.findall(document.read_text()) if "(message)" not in each]
    avatar = physkin_core.load_avatar(physkin_core.BUNDLED_AVATAR, model.rig)
    given = {"physkin": physkin_core, "model": model, "avatar": avatar, "positions": model.rig.rest.copy()}
    if any("draper" in block for block in blocks):
        given["draper"] = physkin_core.Draper(model, avatar)
    for block in blocks:
        exec(compile(block, str(document), "exec"), given)
