"""The rig: bones and named joints, the canonical A-pose, and which bone of another naming is which of ours."""
