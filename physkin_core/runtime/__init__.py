"""Draping: a garment model bound to one avatar once, then one evaluator call a frame, in C++ or NumPy."""
