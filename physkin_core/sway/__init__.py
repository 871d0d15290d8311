"""Cloth that lags, swings and settles: what each frame needs of gravity, time, wind and the moving root."""
