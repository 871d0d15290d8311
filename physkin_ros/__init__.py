"""PhySkin for ROS 2: the `drape_node`, which turns joint states into garment point clouds."""
