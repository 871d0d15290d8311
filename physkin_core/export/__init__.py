"""Draped motion in files that other tools open: glTF with garment nodes as joints, USD with every vertex."""
