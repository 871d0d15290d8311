"""Garment transfer: what a trained garment model hands on to another garment, or to a new training run."""
