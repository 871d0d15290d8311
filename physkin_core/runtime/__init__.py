"""Draping: a garment model bound to one avatar once, then one call of the evaluator in C++ a frame."""
