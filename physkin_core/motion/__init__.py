"""Motion: clips of joint positions, and recordings of other skeletons carried over to the rig."""
