"""The order of two layers: what of the yielding one is on the wrong side of the steady one is pushed along its normal.

Every contact has a partner, the closest vertex of the steady layer, looked for among those that it meets in everyday
poses, the last frame's and the partners of contacts around, and walked from there along the mesh. The planes around the
partner, weighted by how near they are along the cloth, say how far on the right side the contact is.

Dimensions: `r` vertices of the steady layer, `s` contacts.
"""

import numpy as np

GAP, SOFT = 0.003, 0.001
"""[m] between the layers; pushing sets in this much before it must."""
MOST_PUSH, DEEPEST, FADE = 0.05, 0.07, 0.01
"""[m] A contact deeper than the second is of another part of the body; over the last centimetre pushing fades."""
FREE, FAR_ASIDE, NEAR = 0.01, 2.0, 0.005
"""A contact this far [m] off its partner's plane, or this many mean edges beside it, is free: it is looked at only in
its turn. One farther off the plane than the third [m] is right."""
TURNS = 8
"""Frames in which every contact has its turn to look for a closer partner."""
LOST, PLANE_REACH, FULL_SHARE = 1.0, 1.3, 0.5
"""In mean edges: beside its partner a contact looks for a closer one at once; how far planes count. Planes that count
less than the third together push less."""
PUSH_PACE = 0.5
"""[m/s] by which pushes grow or give way."""
STEPS, PASSES, AGAIN = 3, 4, 0.002
"""The most a partner is walked; times that contacts are looked at, again those that have moved by more than the third
[m]."""


class LayerOrder:
    """Keeps the order of two layers frame by frame. order: the product's `LayerOrder`, its indices."""

    def __init__(self, order):
        self._order, self._side = order, 1 if order.yielding > order.steady else -1
        self._rings = [[own, *ring] for own, ring in enumerate(np.split(order.ring, order.ring_start[1:-1]))]
        self._seeds = np.split(order.seed, order.seed_start[1:-1])
        self._pushes = np.split(order.push_to, order.push_start[1:-1])
        self._shares = np.split(order.push_share, order.push_start[1:-1])
        self._partner = order.seed[order.seed_start[:-1]].astype(int)
        self._pushed_partner = self._partner.copy()
        self._free = np.zeros(len(order.contact), dtype=bool)
        self._last_total = np.zeros(len(order.moved))
        self._frame = 0

    def apply(self, steady, yielding, *, look_at_all, passed=-1.0):
        """Move the yielding layer (n, 6), positions and unit normals, on the right side of the steady one (r, 6).

        look_at_all: do not trust the last frame in where nothing can touch. passed: [s] since that, by which pushes
        keep their pace; negative: that does not count.
        """
        order = self._order
        place = np.searchsorted(order.moved, order.contact)
        turns = look_at_all | (np.arange(len(order.contact)) % TURNS == self._frame % TURNS)
        looked_at = turns | ~self._free
        self._frame += 1
        start = self._partner.copy()
        for c in np.flatnonzero(looked_at):
            _, aside = off_plane(yielding[order.contact[c], :3], steady[start[c]])
            if turns[c] or aside > (LOST * order.edge) ** 2:
                self._partner[c] = self._closest(c, start, steady, yielding)
        partner = self._partner
        total = np.zeros(len(order.moved))
        for again in range(PASSES):
            if again:
                before = partner.copy()
                partner = before.copy()
                for c in np.flatnonzero(looked_at):
                    partner[c] = self._closest(c, before, steady, yielding)
                self._pushed_partner[looked_at] = partner[looked_at]
            push = np.zeros(len(order.moved))
            for c in np.flatnonzero(looked_at):
                lack, free = self._lack(yielding[order.contact[c]], partner[c], steady)
                if not again:
                    self._free[c] = free
                before, asked = push[self._pushes[c]], lack * self._shares[c]
                push[self._pushes[c]] = np.where(np.abs(asked) > np.abs(before), asked, before)
            yielding[order.moved, :3] += self._side * push[:, None] * yielding[order.moved, 3:]
            total += push
            looked_at = np.abs(push[place]) > AGAIN
        kept = total
        if passed >= 0:
            kept = np.clip(total, self._last_total - PUSH_PACE * passed, self._last_total + PUSH_PACE * passed)
            yielding[order.moved, :3] += self._side * (kept - total)[:, None] * yielding[order.moved, 3:]
        self._last_total = kept

    def _closest(self, contact, partner, steady, yielding):
        """The steady vertex closest to a contact that it finds: of those it knows, then from there along edges."""
        at = yielding[self._order.contact[contact], :3]
        known = [partner[contact], self._pushed_partner[contact], *partner[self._order.beside[contact]]]
        found = closest(at, steady, [*known, *self._seeds[contact]])
        for _ in range(STEPS):
            found = closest(at, steady, self._rings[found])
        return found

    def _lack(self, row, partner, steady):
        """[m] by which a contact (6,) must be pushed, and whether it is free."""
        edge, ring = self._order.edge, self._rings[partner]
        off, aside = off_plane(row[:3], steady[partner])
        free = self._side * off > FREE or aside > (FAR_ASIDE * edge) ** 2
        if free or self._side * off > NEAR:
            return 0.0, free
        away, aside = off_plane(row[:3], steady[ring])
        share = np.maximum(1 - aside / (PLANE_REACH * edge) ** 2, 0) ** 2
        total = max(share.sum(), 1e-6)
        gap = self._side * (share @ away) / total
        alike = share @ steady[ring, 3:] @ row[3:] / total
        wanted = max(GAP + SOFT - gap, 0)
        lack = wanted**2 / (4 * SOFT) if wanted < 2 * SOFT else wanted - SOFT
        lack *= min(share.sum() / FULL_SHARE, 1) * np.clip((DEEPEST + gap) / FADE, 0, 1)
        return min(lack * np.clip(4 * alike, 0, 1) / max(alike, 0.5), MOST_PUSH), free


def closest(point, steady, candidates):
    """Of candidates, indices of steady vertices (r, 6), the one closest to a point (3,)."""
    return candidates[np.square(steady[candidates, :3] - point).sum(axis=1).argmin()]


def off_plane(point, planes):
    """Signed distance [m] of a point (3,) from planes (..., 6), and the square of the distance along them."""
    gap = point - planes[..., :3]
    off = (gap * planes[..., 3:]).sum(axis=-1)
    return off, (gap * gap).sum(axis=-1) - off * off
