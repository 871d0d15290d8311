"""Meshes with their look, of garments and avatars alike: texture places, materials, pictures, parts, stitches, hems."""
