"""Measures and judges how garments sit on an avatar: `physkin check`."""
