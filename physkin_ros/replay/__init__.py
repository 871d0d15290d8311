"""Bags without ROS: motion clips written to them, joint states of them draped and measured, with a report.

Imports go one way: `bags`, `replay` (draping and measuring), `figures`, `report`, and the commands above them. Playing
a bag to live topics needs ROS and is in `physkin_ros.tools.live`.
"""
