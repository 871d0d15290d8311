"""Mesh files read into arrays, whatever they are of; what is wrong with one is a `ContentError`."""
