"""Cloth that hangs free dented, detail node by detail node: out of the skin where garment nodes could not keep it, and
towards the body where hands and forearms press it.

Each dent sample stands for a detail node. A part of the body asks for what the sample lacks along the normal, somewhat
more, near garment nodes that the skin guard still had to move; an arm for what leads the sample over it in the arm's
cross section, towards the body, less beside it, and less from where it has passed by. What is asked by several parts
is weighted by how much it is, towards the body no more than there is room, and what neighbours that are not asked hold
back is added. The fields are those of `physkin_core.runtime.skin_guard`.
"""

import numpy as np

from reference.guard.skin_guard import sampled_cloth, skin_depth
from reference.skinning import skin

SOFT, GAP, REACH, FULL, ASIDE, FLATTEST, BLUR, FAR = 0.002, 0.003, 0.08, 0.04, 0.06, 0.5, 0.02, 0.3
AHEAD, TOO_DEEP, FADE, FLATTENED, LEAST, STATIONS, MOVED, LEFT, EDGE = 1.4, 0.15, 0.05, 0.3, 1e-5, 4, 0.001, 0.01, 0.005


def dents(bound, bones, nodes, still_moved, features):
    """(D, 3) what is added to offsets of detail nodes. nodes: (m, 3, 4) kept out of the skin. still_moved: (m,) [m],
    how far the guard moved garment nodes in its last pass."""
    added = np.zeros((len(bound.detail_offsets) // 3, 3))
    if not len(bound.dent_vertices):
        return added
    at = skin(sampled_cloth(bound, "dent"), nodes, features)[0]
    arms = np.flatnonzero(bound.skin_presses)
    body = np.flatnonzero(bound.skin_presses == 0)
    carrier = np.take_along_axis(bound.dent_influence_nodes, bound.dent_influence_weights.argmax(axis=1)[:, None], 1)[
        :, 0
    ]
    pressed = [_pressed(bound, part, bones, at, _way(bound, part, body, bones)) for part in arms]
    length, way = _together(pressed)
    room, towards = _body(bound, body, bones, at)
    along, room = length * (way * towards).sum(axis=1), np.maximum(room - LEFT, 0)
    length = np.where(along > room, length * room / np.where(along > 0, along, 1), length)
    pushed = [_pushed(bound, part, bones, at, still_moved[carrier]) for part in body]
    wanted, way = _together([(length, way), *pushed])
    chosen = np.flatnonzero(wanted > LEAST)
    moves = np.zeros_like(added)
    moves[bound.dent_nodes[chosen]] = (bound.dent_shares * wanted)[chosen, None] * way[chosen]
    weights = bound.dent_detail_weights[chosen].astype(np.float64)
    by = 2 * moves[bound.dent_nodes[chosen]] - np.einsum("sj,sji->si", weights, moves[bound.dent_detail_nodes[chosen]])
    linear = np.einsum(
        "sk,skij->sij", bound.dent_influence_weights[chosen], nodes[bound.dent_influence_nodes[chosen]][..., :3]
    )
    x, y, z = np.moveaxis(linear, 2, 0)
    volume = np.maximum((x * np.cross(y, z)).sum(axis=1), FLATTENED)
    rows = np.stack([np.cross(y, z), np.cross(z, x), np.cross(x, y)], axis=1)
    added[bound.dent_nodes[chosen]] = np.einsum("sij,sj->si", rows, by) / volume[:, None]
    return added


def _together(asked):
    """Mean length (s,) and way (s, 3) of what parts ask for, each weighted by how much it is."""
    total = sum(length for length, _ in asked)
    wanted = sum(length[:, None] ** 2 * way for length, way in asked) / np.maximum(total, 1e-15)[:, None]
    length = np.linalg.norm(wanted, axis=1)
    return length, wanted / np.maximum(length, 1e-15)[:, None]


def _soft(wanted):
    return np.where(wanted < 2 * SOFT, np.maximum(wanted, 0) ** 2 / (4 * SOFT), wanted - SOFT)


def _pushed(bound, part, bones, at, moved):
    """What samples (s, 3) lack of a part of the body, (s,) [m], and the ways out of it (s, 3)."""
    depth, normal = skin_depth(bound, part, bones, at)
    lack = _soft(depth + GAP + SOFT) * AHEAD * np.clip((TOO_DEEP - depth) / FADE, 0, 1)
    return np.clip((moved - MOVED) / MOVED, 0, 1) * lack, normal


def _pressed(bound, part, bones, at, way):
    """The same of an arm, whose way (3,) to the body is theirs."""
    frame, bone = bound.skin_frames[part].astype(np.float64), bones[bound.skin_bones[part, 0]]
    back = frame[:, :3] @ bone[:, :3].T
    depth, _ = skin_depth(bound, part, bones, at)
    x, y = ((at - bone[:, 3]) @ back.T + frame[:, 3])[:, :2].T - bound.skin_shapes[part, :2, None]
    across = back @ way
    flat = np.sqrt(across[0] ** 2 + across[1] ** 2 + 1e-6)
    along = (x * across[0] + y * across[1]) / flat
    aside = np.sqrt(np.maximum(x**2 + y**2 - along**2, 0))
    radius = np.sqrt(x**2 + y**2) + depth + GAP
    leaves = np.sqrt(np.where(aside < radius, radius**2 - aside**2, 0) + EDGE**2) - EDGE
    least = np.where(aside < radius, 1, np.maximum(1 - (aside - radius) / ASIDE, 0))
    wanted = least * np.maximum(leaves - along, 0) / max(flat, FLATTEST)
    faded = np.clip((depth + REACH) / (REACH - FULL), 0, 1)
    return faded * _soft(wanted), np.broadcast_to(way, at.shape)


def _way(bound, part, body, bones):
    """(3,) from places along an arm to the body."""
    ends = _axis_end(bound, part, bones, 0), _axis_end(bound, part, bones, -1)
    stations = np.array([ends[0] + (k + 0.5) / STATIONS * (ends[1] - ends[0]) for k in range(STATIONS)])
    way = _body(bound, body, bones, stations)[1].sum(axis=0)
    return way / max(np.linalg.norm(way), 1e-15)


def _axis_end(bound, part, bones, which):
    """(3,) where an arm's axis begins, or, -1, ends, as the first or the last of its bones has it."""
    frame, (x, y, low, high, _) = bound.skin_frames[part].astype(np.float64), bound.skin_shapes[part].astype(np.float64)
    turning = bound.skin_bones[part][bound.skin_heights[part] < 1e3]
    bone = bones[turning[which]]
    canonical = frame[:, :3].T @ (np.array([x, y, low if which == 0 else high]) - frame[:, 3])
    return bone[:, :3] @ canonical + bone[:, 3]


def _body(bound, body, bones, at):
    """How far points (s, 3) are from the body, (s,) [m], and unit ways there (s, 3), of near parts together."""
    room, ways = np.full(len(at), FAR), np.zeros((len(at), 3))
    for part in body:
        depth, normal = skin_depth(bound, part, bones, at)
        ways -= (BLUR / (np.maximum(-depth, 0) + BLUR))[:, None] ** 4 * normal
        room = np.minimum(room, -depth)
    return room, ways / np.maximum(np.linalg.norm(ways, axis=1, keepdims=True), 1e-15)
