"""Motion: clips of joint positions, and recordings of other skeletons retargeted to the rig."""
