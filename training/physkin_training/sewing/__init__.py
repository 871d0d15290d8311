"""Turns a sewing pattern into a garment: reads it, cuts it into triangles, hangs it about the body, sews it."""
