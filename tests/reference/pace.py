"""The pace of cloth: from frame to frame garment nodes go little farther than their bones carry them, and so do detail
nodes in the garment at rest."""

import numpy as np

PACE = 2.0
"""[m/s] by which a garment node, and cloth beside it, may be faster than its bone; and a detail node at rest."""
REACH = 0.1
"""[m] how far beside a garment node cloth lies that it carries."""


class Pace:
    """What is kept of the last frame, of one garment."""

    def __init__(self):
        self._last = None

    def kept(self, posed, nodes, offsets, passed):
        """Garment nodes (m, 3, 4) brought back on the way where they have leapt, or turned over in their bone, and
        offsets (D, 3) of detail nodes likewise.

        posed: (m, 3, 4) as their bones alone put them; nodes: as draped. passed: [s] since the last frame, negative
        where that does not count.
        """
        turn, carried, kept = posed[:, :, :3], posed[:, :, 3], nodes.copy()
        linear, position = turn.transpose(0, 2, 1) @ nodes[:, :, :3], nodes[:, :, 3]
        if self._last is not None and passed >= 0:
            last_linear, last_position, last_carried, last_offsets = self._last
            free = np.linalg.norm(carried - last_carried, axis=1) + PACE * passed
            moves = _share(free, np.linalg.norm(position - last_position, axis=1))[:, None]
            turns = _share(PACE * passed, REACH * np.linalg.norm(linear - last_linear, axis=(1, 2)))[:, None, None]
            shifts = _share(PACE * passed, np.linalg.norm(offsets - last_offsets, axis=1))[:, None]
            position = np.where(moves < 1, last_position + moves * (position - last_position), position)
            linear = np.where(turns < 1, last_linear + turns * (linear - last_linear), linear)
            offsets = np.where(shifts < 1, last_offsets + shifts * (offsets - last_offsets), offsets)
            kept = np.concatenate([np.where(turns < 1, turn @ linear, nodes[:, :, :3]), position[..., None]], axis=2)
        self._last = linear, position, carried, offsets
        return kept, offsets


def _share(allowed, wanted):
    return np.where(wanted > allowed, allowed / np.maximum(wanted, 1e-30), 1.0)
