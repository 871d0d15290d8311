"""Cloth that hangs is kept out of the skin: by garment nodes, then by detail nodes."""
