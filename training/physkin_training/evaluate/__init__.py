"""Measures garments: figures on held-out bodies and motion, minima, simulated drapes, contact sheets."""
