"""Draped motion as a film: the outfit in the world, a camera, and files that hold moving pictures."""
