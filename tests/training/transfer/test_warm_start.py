"""A new run from a garment model file."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from training.small_runs import SMALL_DETAIL, exported, small_config

from physkin_core.model.model_file import save_garment_model
from physkin_training.config import DetailConfig, as_toml, load_config
from physkin_training.networks.export import agreement
from physkin_training.train.trainer import Trainer
from physkin_training.transfer.warm_start import NEW_INFLUENCE, take_over_model

CPU = torch.device("cpu")


@pytest.fixture(scope="module", params=[DetailConfig(), SMALL_DETAIL], ids=["plain", "with detail"])
def trained(request, tmp_path_factory):
    """The folder of a configuration and a model of it that was pruned to three influences, as a file holds it."""
    folder = tmp_path_factory.mktemp("warm")
    trainer = Trainer(replace(small_config(folder), detail=request.param), CPU)
    with torch.no_grad():
        for name, parameter in trainer.drape.named_parameters():
            parameter += (0.005 if name.endswith("offsets.weight") else 0.05) * torch.randn_like(parameter)
    model = exported(trainer, 3)
    save_garment_model(model, folder / "band.safetensors")
    return folder, model


def more_influences(folder, **optimisation):
    config = small_config(folder, **optimisation)
    nodes = replace(config.garment_nodes, initial_influences=5, influences=5)
    return replace(config, garment_nodes=nodes, detail=SMALL_DETAIL)


def test_the_run_drapes_as_the_model_but_for_its_new_influences(trained):
    """Inputs shifted and scaled otherwise, five influences, not three: with the new ones at nothing, the same."""
    folder, model = trained
    trainer = Trainer(more_influences(folder), CPU)
    trainer.start_from(folder / "band.safetensors")
    assert trainer.started_from == {"model": "band", "seed": 5}
    for ours, averaged in zip(trainer.drape.parameters(), trainer.averaged.parameters(), strict=True):
        assert torch.equal(ours, averaged)
    weights = trainer.drape.skinning_weights.detach()
    new = (weights < 2 * NEW_INFLUENCE).sum(dim=1)
    assert (new >= 2).all(), "two of five influences are new"
    assert agreement(model, trainer.drape, poses=2).largest < 2e-3
    with torch.no_grad():
        logits = trainer.drape.skinning_logits
        logits[logits <= np.log(NEW_INFLUENCE) + 1e-6] = -30.0
    # What is left is the rounding in the file.
    assert agreement(model, trainer.drape, poses=2).largest < 3e-4


def test_other_models_are_refused(trained):
    """Another garment, and other sizes."""
    folder, model = trained
    config = small_config(folder)
    drape = Trainer(config, CPU).drape
    moved = replace(model, garment=model.garment.reshaped(model.garment.vertices + 0.01))
    with pytest.raises(ValueError, match="its vertices differ"):
        take_over_model(moved, drape)
    wider = replace(config, networks=replace(config.networks, pose_hidden=25))
    with pytest.raises(ValueError, match=r"pose_modulator.layers.0.* is \(24, .*expected \(25, "):
        take_over_model(model, Trainer(wider, CPU).drape)


def test_a_configuration_may_name_its_start(trained):
    """Garment nodes are the start's, whatever would be sampled, and the run drapes as it does from the first step."""
    folder, model = trained
    other_nodes = replace(model, node_rest=model.node_rest + np.float32(0.01))
    save_garment_model(other_nodes, folder / "start.safetensors")
    config = replace(small_config(folder), start=folder / "start.safetensors")
    trainer = Trainer(config, CPU)
    assert torch.allclose(trainer.drape.node_rest, torch.as_tensor(other_nodes.node_rest), atol=1e-4)
    assert trainer.started_from == {"model": "band", "seed": 5}
    assert agreement(other_nodes, trainer.averaged, poses=2).largest < 1e-3
    (folder / "start.toml").write_text(as_toml(config))
    assert load_config(folder / "start.toml").start == config.start
