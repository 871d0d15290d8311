"""Bags: written from motions, draped and measured without a running node. Needs no ROS."""
