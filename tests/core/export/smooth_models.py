"""Shipped garments as those are that were not sewn."""

from dataclasses import replace

from physkin_core import Garment, GarmentModel, load_garment_model


def smooth_model(name: str) -> GarmentModel:
    """A shipped garment without folds, panels and sway network: one mesh, moved by its garment nodes alone."""
    model = load_garment_model(name)
    garment = Garment(model.garment.vertices, model.garment.faces)
    return replace(model, detail=None, sway=None, garment=garment)
