"""How a root moves, pose by pose: velocity and turning from the pose before to this one, in its frame."""

import numpy as np
from scipy.spatial.transform import Rotation

LARGEST_GAP = 0.25
"""[s] Poses farther apart say nothing of how the root moved between them."""
LARGEST_CHANGE, LARGEST_CHANGE_OF_TURNING = 8.0, 20.0
"""[m/s, rad/s] A change of velocity, or of turning, from pose to pose beyond this is a jump, not a motion."""


class RootTracker:
    """Of one avatar. turn: of the last pose, world <- root."""

    def __init__(self):
        self._time, self._motion = None, None

    def move(self, time, root):
        """The root (7,), position and quaternion x, y, z, w, is there at `time` [s]; a time that comes twice changes
        nothing."""
        if time == self._time:
            return
        position, turn = np.asarray(root[:3], dtype=np.float64), Rotation.from_quat(root[3:])
        motion = None
        if self._time is not None and 0 < time - self._time <= LARGEST_GAP:
            passed = time - self._time
            motion = (position - self._position) / passed, (self.turn.inv() * turn).as_rotvec() / passed
            changes = (0, 0) if self._motion is None else [np.linalg.norm(a - b) for a, b in zip(motion, self._motion)]
            if changes[0] > LARGEST_CHANGE or changes[1] > LARGEST_CHANGE_OF_TURNING:
                motion = None
        self._time, self._position, self.turn, self._motion = time, position, turn, motion

    def motion(self):
        """The root's velocity (3,) and turning (3,) up to the last pose, in its frame; None after a gap or jump."""
        return None if self._motion is None else (self.turn.inv().apply(self._motion[0]), self._motion[1])
