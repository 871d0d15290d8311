"""Draping: binds a garment model to an avatar once, then calls the C++ evaluator once per frame."""
