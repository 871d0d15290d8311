"""The ROS node: parameters, joint states in and clouds out, changes while it runs, diagnostics."""
