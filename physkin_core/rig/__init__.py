"""The rig: bones and named joints, the canonical A-pose, and how bones of other skeletons map to its bones."""
