"""Turns joint states of any sender into joint positions of the rig. Needs no ROS."""
