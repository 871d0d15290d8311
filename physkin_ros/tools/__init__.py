"""Commands that run ROS processes: the demo of the node, the page of a running node, a bag played to live topics."""
