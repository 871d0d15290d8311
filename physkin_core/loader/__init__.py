"""Reads bodies, garments and motion in a separate process: a damaged or endless file only makes its request fail."""
