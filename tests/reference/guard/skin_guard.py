"""Cloth that hangs free kept out of legs and trunk: garment nodes sway less, then move along the skin's normals.

Where sway leads a sample through the middle of a part of the skin, the share of it that lies behind where it enters
is to go. After that, where a sample lacks something along the normal and sway has cost it something there, a share of
its sway is to go: what it lacks, divided by that cost, which is rounded where it is small. Of a garment node the
largest share goes that is asked for by samples of which it carries a tenth or more, and less by others. Then it moves
by the mean, over samples that it carries, of what each still lacks along the normal, weighted by skinning weight times
lack; twice, the second time seeing what the first has left. The fields are those of `physkin_core.runtime.skin_guard`;
depths are those of the product's `RadialShape`.
"""

import numpy as np

from physkin_core.body_shape.radial_shape import RadialShape
from physkin_core.model.skinning import SkinningData
from reference.skinning import skin

SOFT, TOO_DEEP, FADE, PASSES = 0.002, 0.15, 0.05, 2
WORTHWHILE, CARRIES, CARRIES_THROUGH, REACH, AGAINST = 0.002, 0.2, 0.3, 0.05, 0.5
MIDDLE, LEAST, DIRECTIONS = 0.6, 1e-9, 32


def kept_out(bound, bones, nodes, sway, features=()):
    """Garment nodes (m, 3, 4) moved out of the skin of bones (b, 3, 4), and how far they still were in the last pass,
    (m,) [m]. sway: (m, 3, 4) what it has added to them. features: (F,), of a garment with detail."""
    if not len(bound.guard_vertices):
        return nodes, np.zeros(len(nodes))
    nodes = nodes.copy()
    sampled = sampled_cloth(bound, "guard")
    samples, count = len(bound.guard_vertices), len(nodes)
    weights = np.zeros((samples, count))
    np.add.at(weights, (np.arange(samples)[:, None], bound.guard_influence_nodes), bound.guard_influence_weights)
    if sway.any():
        start, end = (skin(sampled, each, features)[0] for each in (nodes - sway, nodes))
        gone = _share_to_go(weights, _crossed(bound, bones, start, end), CARRIES_THROUGH)
        nodes, sway = nodes - gone[:, None, None] * sway, (1 - gone)[:, None, None] * sway
    for k in range(PASSES):
        lacks = list(_lacks(bound, bones, skin(sampled, nodes, features)[0]))
        if k == 0:
            swayed, _ = skin(sampled, sway, features)
            costs = [np.maximum(-(swayed * normal).sum(axis=1), 0) for _, normal in lacks]
            needed = [np.minimum(lack * cost / (cost**2 + WORTHWHILE**2), 1) for (lack, _), cost in zip(lacks, costs)]
            gone = _share_to_go(weights, np.max(needed, axis=0), CARRIES)
            nodes -= gone[:, None, None] * sway
            gained = [(weights @ gone) * cost for cost in costs]
            lacks = [(np.maximum(lack - gain, 0), normal) for (lack, normal), gain in zip(lacks, gained)]
        counted, moved = np.zeros(count), np.zeros((count, 3))
        for lack, normal in lacks:
            share = weights * lack[:, None]
            counted += share.sum(axis=0)
            moved += share.T @ (lack[:, None] * normal)
        by = np.where(counted > 1e-9, 1 / np.maximum(counted, 1e-9), 0)[:, None] * moved
        nodes[:, :, 3] += by
    return nodes, np.linalg.norm(by, axis=1)


def _share_to_go(weights, needed, carries):
    """Of each garment node's sway, (m,), where samples need such shares (s,) gone."""
    return (needed[:, None] * np.minimum(weights / carries, 1)).max(axis=0)


def _crossed(bound, bones, start, end):
    """Shares (s,) of the ways of samples from start to end (s, 3) that are to go, the largest of all parts."""
    shares = [np.zeros(len(start))]
    for part in np.flatnonzero(bound.skin_presses == 0):
        axis, widths = _axis(bound, part, bones)
        for first, last, width in zip(axis[:-1], axis[1:], widths):
            way, x, d = last - first, start - first, end - start
            square, length = max(way @ way, LEAST), np.maximum((d**2).sum(axis=1), LEAST)
            ahead, beside, begin = (d * x).sum(axis=1), d @ way, x @ way
            share = np.clip((beside * begin - ahead * square) / np.maximum(length * square - beside**2, LEAST), 0, 1)
            along = np.clip((beside * share + begin) / square, 0, 1)
            share = np.clip((beside * along - ahead) / length, 0, 1)
            near = ((x + share[:, None] * d - along[:, None] * way) ** 2).sum(axis=1)
            first_off = ((x - np.clip(begin / square, 0, 1)[:, None] * way) ** 2).sum(axis=1)
            outer, inner = MIDDLE**2 * width**2, (MIDDLE / 2) ** 2 * width**2
            outside = np.clip((first_off - outer) / (width**2 - outer), 0, 1)
            through = np.clip((outer - near) / (outer - inner), 0, 1)
            enters = np.clip(share - np.sqrt(np.maximum((width**2 - near) / length, LEAST)), 0, 1)
            shares.append(bound.guard_shares * outside * through * (1 - enters))
    return np.max(shares, axis=0)


def _axis(bound, part, bones):
    """Posed points (k + 1, 3) of a part's axis, and its widths [m] between them, (k,)."""
    x, y, low, high, _ = bound.skin_shapes[part].astype(np.float64)
    count = int((bound.skin_heights[part] < 1e3).sum())
    heights = np.array([low, *bound.skin_heights[part][1:count], high], dtype=np.float64)
    frame, points = bound.skin_frames[part].astype(np.float64), []
    for k, height in enumerate(heights):
        bone = bones[bound.skin_bones[part][min(k, count - 1)]]
        canonical = frame[:, :3].T @ (np.array([x, y, height]) - frame[:, 3])
        points.append(bone[:, :3] @ canonical + bone[:, 3])
    coefficients = bound.skin_coefficients[part].astype(np.float64)
    cells = np.clip((heights - low) * (len(coefficients) - 2) / (high - low), 0, len(coefficients) - 2).astype(int)
    angles = 2 * np.pi / DIRECTIONS * np.arange(DIRECTIONS)
    waves = [np.ones(DIRECTIONS)]
    for h in range(1, (coefficients.shape[1] + 1) // 2):
        waves += [np.cos(h * angles), np.sin(h * angles)]
    radii = (coefficients @ np.array(waves)).max(axis=1)
    widths = [radii[a : max(a, min(b + 2, len(radii) - 1)) + 1].max(initial=0) for a, b in zip(cells[:-1], cells[1:])]
    return np.array(points), np.array(widths)


def sampled_cloth(bound, kind):
    """The cloth that is looked at as the `kind` of sample, "guard" or "dent", to be skinned."""
    fields = ("vertices", "influence_nodes", "influence_weights", "detail_nodes", "detail_weights")
    sampled = {name: getattr(bound, f"{kind}_{name}") for name in fields}
    rest = {"node_rest": bound.node_rest, "detail_offsets": bound.detail_offsets}
    return SkinningData(normals=sampled["vertices"], **rest, **sampled)


def _lacks(bound, bones, at):
    """What samples (s, 3) lack in each part of the skin, (s,) [m], and the ways out, (s, 3)."""
    for part in np.flatnonzero(bound.skin_presses == 0):
        depth, normal = skin_depth(bound, part, bones, at)
        lack, normal = _led_back(bound, part, bones, at, depth, _soft(depth + bound.guard_gaps[part]), normal)
        yield bound.guard_shares * np.clip((TOO_DEEP - depth) / FADE, 0, 1) * np.maximum(lack, 0), normal


def _led_back(bound, part, bones, at, depth, lack, normal):
    """The same of a shin whose normal is against the way back over it: lacks (s,) and ways out (s, 3) are turned there,
    to the far side of a circle about its axis; less from its skin outwards."""
    frame, bone = bound.skin_frames[part].astype(np.float64), bones[bound.skin_bones[part, 0]]
    back = frame[:, :3] @ bone[:, :3].T
    away = ((at - bone[:, 3]) @ back.T + frame[:, 3])[:, :2] - bound.skin_shapes[part, :2]
    out = bound.guard_ways[part] @ back[:2]
    against = np.where(depth > -REACH, np.clip(-(normal * out).sum(axis=1) / AGAINST, 0, 1), 0)
    turned = against**2 * (3 - 2 * against)
    towards = (1 - turned)[:, None] * normal + turned[:, None] * out
    towards /= np.maximum(np.linalg.norm(towards, axis=1, keepdims=True), 1e-12)
    across = towards @ back[:2].T
    flat = np.sqrt((across**2).sum(axis=1) + 1e-6)
    along, square = (away * across).sum(axis=1) / flat, (away**2).sum(axis=1)
    radius = np.sqrt(square) + depth + np.maximum(bound.guard_gaps[part], 0)
    over = (np.sqrt(np.maximum(radius**2 - square + along**2, 0)) - along) / flat
    faded = np.clip((depth + REACH) / REACH, 0, 1)
    return lack + turned * (faded * over - lack), np.where(turned[:, None] > 0, towards, normal)


def _soft(lacking):
    over = np.maximum(lacking + SOFT, 0)
    return np.where(over < 2 * SOFT, over**2 / (4 * SOFT), over - SOFT)


def skin_depth(bound, part, bones, points):
    """(s,) of points (s, 3) in a part of the skin, and unit normals (s, 3) in the root frame."""
    x, y, low, high, blend = bound.skin_shapes[part].astype(np.float64)
    frame = bound.skin_frames[part].astype(np.float64)
    taken_over = bound.skin_heights[part] < 1e3
    at = turn = None
    for bone, height in zip(bound.skin_bones[part][taken_over], bound.skin_heights[part][taken_over]):
        back = frame[:, :3] @ bones[bone, :, :3].T
        seen = (points - bones[bone, :, 3]) @ back.T + frame[:, 3]
        if at is None:
            at, turn = seen, np.repeat(back[None], len(points), axis=0)
            continue
        share = np.clip(0.5 + (0.5 * (at[:, 2] + seen[:, 2]) - height) / blend, 0, 1)
        share = share**2 * (3 - 2 * share)
        at = at + share[:, None] * (seen - at)
        turn = turn + share[:, None, None] * (back - turn)
    depth, normal = RadialShape(np.array([x, y]), low, high, bound.skin_coefficients[part].astype(np.float64)).depth(at)
    normal = np.einsum("sji,sj->si", turn, normal)
    return depth, normal / np.maximum(np.linalg.norm(normal, axis=1), 1e-12)[:, None]
