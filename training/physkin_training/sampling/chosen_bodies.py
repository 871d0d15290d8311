"""Which bodies stand for all of them: from the leanest to the stoutest, and of each age."""

from __future__ import annotations

import numpy as np

from physkin_core.avatar.body_model import BodyModel

__all__ = ["bodies_by_girth", "held_out_groups"]


def bodies_by_girth(body_model: BodyModel, count: int, *, of: np.ndarray | None = None) -> list[int]:
    """Indices of `count` bodies, default of held-out ones, evenly spread by volume for their squared height: the first
    has the least, the last the most; of one, the median. of: (S, c) shape coefficients. Raises ValueError where there
    are not so many."""
    bodies = body_model.held_out_bodies if of is None else of
    if not 1 <= count <= len(bodies):
        raise ValueError(f"bodies must be 1 to {len(bodies)}, got {count}")
    index = []
    for coefficients in bodies:
        vertices = body_model.vertices(coefficients).astype(np.float64)
        a, b, c = vertices[body_model.faces].transpose(1, 0, 2)
        index.append((a * np.cross(b, c)).sum() / 6 / np.ptp(vertices[:, 2]) ** 2)
    places = np.linspace(0, len(index) - 1, count) if count > 1 else np.array([(len(index) - 1) / 2])
    return np.argsort(index)[np.floor(places + 0.5).astype(int)].tolist()


def held_out_groups(body_model: BodyModel, count: int) -> dict[str, np.ndarray]:
    """Shape coefficients (S, c) of at most `count` held-out bodies of each age, and of the leanest and stoutest third
    of the adults. Raises ValueError where there are not so many adults."""
    adults = body_model.held_out_bodies[:count]
    by_girth, third = adults[bodies_by_girth(body_model, count, of=adults)], -(-count // 3)
    return {
        "adults": adults,
        "lean": by_girth[:third],
        "stout": by_girth[-third:],
        "children": body_model.held_out_children[:count],
        "elders": body_model.held_out_elders[:count],
    }
