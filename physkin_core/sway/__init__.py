"""Cloth that lags, swings and settles: what a frame is given of gravity, time and a root that moves."""
