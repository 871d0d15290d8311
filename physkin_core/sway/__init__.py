"""Cloth that lags, swings and settles: what a garment feels when its root moves through the world.

A pendulum in place of the cloth is moved by the root. What pulls at it, gravity and its own deflection, is the
effective gravity under which the networks drape: the garment leans, overshoots and comes to rest within what training
knows, in front of limbs and behind them.
"""
