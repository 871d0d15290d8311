"""Examples in the docstrings of the public names: there is one of each, and it gives what it says."""

import doctest
import shutil
import warnings

import numpy as np
import pytest

import physkin_core
from import_graph import ROOT

PUBLIC = [getattr(physkin_core, name) for name in physkin_core.__all__]
EXPLAINED = [
    public for public in PUBLIC if callable(public) and not (isinstance(public, type) and issubclass(public, Exception))
]


@pytest.mark.parametrize("public", EXPLAINED, ids=lambda public: public.__name__)
def test_example_holds(public, tmp_path, monkeypatch):
    """Its own and those of its methods, in a folder with an avatar and a mesh, as readers have them."""
    shutil.copy(physkin_core.BUNDLED_AVATAR, tmp_path / "me.glb")
    shutil.copy(ROOT / "training" / "garments" / "tshirt.obj", tmp_path / "my.obj")
    monkeypatch.chdir(tmp_path)
    globs = {"physkin": physkin_core, "np": np}
    examples = doctest.DocTestFinder(exclude_empty=False).find(public, public.__name__, module=False, globs=globs)
    assert examples[0].examples, "no example"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", physkin_core.AvatarWarning)
        assert sum(doctest.DocTestRunner().run(each).failed for each in examples) == 0
