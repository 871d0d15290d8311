"""Cloth with inertia: implicit Euler on the full mesh, the reference that motion of its own is measured against."""
