"""The twist of cloth that hangs round both legs: its garment nodes turn about the root's vertical, and are lifted."""

import numpy as np

LIFT = 0.2
"""[m/rad2] Threads that twist hang askew: what cloth rises by."""

LIES_ON, HANGS = 0.6, 0.9
"""A thigh this upright (cosine) holds all twist back, and one as upright as the second none."""


def twisted(nodes, bones, shares, node_bone, twist):
    """Garment nodes (m, 3, 4) turned by their shares (m,) of `twist` [rad].

    On legs that are raised cloth lies and hangs no more: it twists by the mean of how upright they are, the less the
    more a thigh is raised. Garment nodes by the thighs twist in part. bones: (b, 3, 4); node_bone: (m,).
    """
    own = bones[node_bone, 2, 2]
    hangs = np.clip((own[(shares > 0) & (shares < 1)].min(initial=1.0) - LIES_ON) / (HANGS - LIES_ON), 0, 1)
    upright = max((shares * own).sum() / shares.sum(), 0.0) * hangs * hangs * (3 - 2 * hangs)
    angle = twist * upright * shares
    turn = np.zeros((len(nodes), 3, 3))
    turn[:, 0, 0] = turn[:, 1, 1] = np.cos(angle)
    turn[:, 1, 0], turn[:, 0, 1], turn[:, 2, 2] = np.sin(angle), -np.sin(angle), 1
    turned = turn @ nodes
    turned[:, 2, 3] += LIFT * twist * upright * angle
    return turned
