"""Offline training of PhySkin garment models: data preparation, networks, physics losses, optimisation, export."""
