"""Commands that run ROS processes: the demo of the node, the page of a running node, and a bag played to live topics.

A `trial` is a drape node, a `listener` and a `player` in processes of their own; the demo and `ros_bench`
differ in what they ask of it and make of its records.
"""
