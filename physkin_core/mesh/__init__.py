"""Meshes with their look: texture places, materials, pictures and parts, of garments and avatars alike."""
