"""Garments of your own: checks and repairs a mesh, lays it on the body, trains it, writes a report."""
