"""The pace of cloth: from frame to frame garment nodes go no farther than their bones carry them, and a little more."""

import numpy as np

PACE = 2.0
"""[m/s] by which a garment node, and cloth beside it, may be faster than its bone."""
REACH = 0.1
"""[m] how far beside a garment node cloth lies that it carries."""


class Pace:
    """What is kept of the last frame, of one garment."""

    def __init__(self):
        self._last = None

    def kept(self, posed, nodes, passed):
        """Garment nodes (m, 3, 4) brought back on the way where they have leapt, or turned over in their bone.

        posed: (m, 3, 4) as their bones alone put them; nodes: as draped. passed: [s] since the last frame, negative
        where that does not count.
        """
        turn, carried, kept = posed[:, :, :3], posed[:, :, 3], nodes.copy()
        linear, position = turn.transpose(0, 2, 1) @ nodes[:, :, :3], nodes[:, :, 3]
        if self._last is not None and passed >= 0:
            last_linear, last_position, last_carried = self._last
            free = np.linalg.norm(carried - last_carried, axis=1) + PACE * passed
            moves = _share(free, np.linalg.norm(position - last_position, axis=1))[:, None]
            turns = _share(PACE * passed, REACH * np.linalg.norm(linear - last_linear, axis=(1, 2)))[:, None, None]
            position = np.where(moves < 1, last_position + moves * (position - last_position), position)
            linear = np.where(turns < 1, last_linear + turns * (linear - last_linear), linear)
            kept = np.concatenate([np.where(turns < 1, turn @ linear, nodes[:, :, :3]), position[..., None]], axis=2)
        self._last = linear, position, carried
        return kept


class FeaturePace:
    """The same of detail nodes, by the features that move them: all go as far as the fastest node may."""

    def __init__(self, detail_offsets):
        self._offsets, self._last = detail_offsets.astype(np.float64), None

    def kept(self, features, passed):
        """Features (F,) between the last ones and those of the networks."""
        if self._last is not None and passed >= 0:
            step = features - self._last
            fastest = np.linalg.norm((self._offsets @ step).reshape(-1, 3), axis=1).max(initial=0)
            features = self._last + _share(PACE * passed, fastest) * step
        self._last = features
        return features


def _share(allowed, wanted):
    return np.where(wanted > allowed, allowed / np.maximum(wanted, 1e-30), 1.0)
