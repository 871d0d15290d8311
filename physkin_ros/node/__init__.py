"""The ROS node: parameters, streams of joint states in and clouds out, swaps while running, diagnostics."""
