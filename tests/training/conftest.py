"""What tests of several folders share: quiet, small validation, and a run of the command to its end."""

from __future__ import annotations

from functools import partialmethod
from pathlib import Path

import numpy as np
import pytest


@pytest.fixture(autouse=True, scope="session")
def quiet():
    """Warp says nothing of what it compiles, the set that models are chosen by is a quarter of its size, models before
    training are looked at on one body, and networks are normalised and rounded over few bodies and poses."""
    try:
        import warp as wp

        from physkin_training.fit_garment import first_model
        from physkin_training.rounding import rounded_model
        from physkin_training.train import trainer, validation
    except ImportError:
        return
    wp.config.quiet = True
    validation.BATCHES = 1
    trainer.NORMALISING_POSES = 64
    first_model.BODIES = 0
    rounded_model.BODIES, rounded_model.EVERYDAY, rounded_model.FARTHER, rounded_model.ENCODED_BODIES = 3, 20, 20, 24


@pytest.fixture(scope="session")
def finished_run(tmp_path_factory) -> Path:
    """A folder with `band.toml`, `band.obj`, and what the command wrote into `out`."""
    from training.small_runs import small_config, train_command

    from physkin_core.cli import main
    from physkin_training.config import as_toml

    folder = tmp_path_factory.mktemp("finished")
    (folder / "band.toml").write_text(as_toml(small_config(folder)))
    assert main(train_command(folder)) == 0
    return folder


@pytest.fixture(scope="session")
def template():
    """The body that garments are checked and trained on."""
    from physkin_core import avatar_from_body, load_body_model

    body_model = load_body_model()
    return avatar_from_body(body_model, body_model.garment_body)


@pytest.fixture
def rough_minima(monkeypatch):
    """Full-space minima after a few iterations, for tests of what is done with them."""
    from physkin_training.physics.full_space_solver import FullSpaceSolver

    monkeypatch.setattr(FullSpaceSolver, "minimise", partialmethod(FullSpaceSolver.minimise, iterations=4))


@pytest.fixture
def no_pictures(monkeypatch):
    """As without the [view] extra."""
    from physkin_core.pictures.picture import PictureError
    from physkin_training.fit_garment import pictures

    def render(*_, **__):
        raise PictureError("none")

    monkeypatch.setattr(pictures, "render", render)


@pytest.fixture
def unfitted_normals(monkeypatch):
    """Export with the mesh's own normals, which saves a second."""
    from physkin_core.model.garment import vertex_normals
    from physkin_training.train import run

    def own(drape, garment, rig) -> np.ndarray:
        return vertex_normals(garment.vertices, garment.faces)

    monkeypatch.setattr(run, "fitted_rest_normals", own)
