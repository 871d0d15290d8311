"""From the joint states of any sender to the joint positions of the rig. Needs no ROS."""
