"""Sway networks: simulates walkers by their garment nodes, and trains a network on how their clothes move."""
