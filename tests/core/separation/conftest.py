"""Stout bodies of the body model, and poses in which their limbs are inside them."""

from __future__ import annotations

import numpy as np
import pytest

from physkin_core import avatar_from_body, load_body_model


def girth(body_model, coefficients) -> float:
    """Volume over height squared [m]."""
    vertices = body_model.vertices(coefficients).astype(np.float64)
    corners = vertices[body_model.faces]
    volume = np.einsum("fi,fi->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6
    return volume / np.ptp(vertices[:, 2]) ** 2


@pytest.fixture(scope="session")
def rig():
    return load_body_model().rig


@pytest.fixture(scope="session")
def bodies():
    """Held-out bodies: the leanest, one in the middle, the stoutest."""
    model = load_body_model()
    order = np.argsort([girth(model, coefficients) for coefficients in model.held_out_bodies])
    chosen = {"lean": order[0], "average": order[len(order) // 2], "stout": order[-1]}
    return {name: avatar_from_body(model, model.held_out_bodies[index]) for name, index in chosen.items()}


@pytest.fixture(scope="session")
def arms_down(rig):
    """(d,) arms as a lean performer lets them hang, forearms turned in a little."""
    return rig.joint_positions(
        {"upperarm01.L_x": -0.7, "upperarm01.R_x": 0.7, "lowerarm01.L_z": -0.2, "lowerarm01.R_z": 0.2}
    ).astype(np.float32)
