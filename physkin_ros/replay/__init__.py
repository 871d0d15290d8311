"""Bags without ROS: writes motion to them, drapes and measures their joint states, writes a report.

Imports go one way: `bags`, `replay` (draping and measuring), `figures`, `report`, and the commands above them. Playing
a bag to live topics needs ROS and is in `physkin_ros.tools.live`.
"""
