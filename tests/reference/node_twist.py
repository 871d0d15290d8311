"""The twist of cloth that hangs round both legs: its garment nodes turn about the root's vertical, and are lifted."""

import numpy as np

LIFT = 0.2
"""[m/rad2] Threads that twist hang askew: what cloth rises by."""


def twisted(nodes, bones, shares, node_bone, twist):
    """Garment nodes (m, 3, 4) turned by their shares (m,) of `twist` [rad].

    On legs that are raised cloth lies and hangs no more: it twists by the mean of how upright they are. bones: (b, 3,
    4); node_bone: (m,).
    """
    upright = max((shares * bones[node_bone, 2, 2]).sum() / shares.sum(), 0.0)
    angle = twist * upright * shares
    turn = np.zeros((len(nodes), 3, 3))
    turn[:, 0, 0] = turn[:, 1, 1] = np.cos(angle)
    turn[:, 1, 0], turn[:, 0, 1], turn[:, 2, 2] = np.sin(angle), -np.sin(angle), 1
    turned = turn @ nodes
    turned[:, 2, 3] += LIFT * twist * upright * angle
    return turned
