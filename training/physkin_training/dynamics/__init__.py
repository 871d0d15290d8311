"""Cloth with inertia: implicit Euler on the full mesh, the reference that sway is compared with."""
