"""Meshes with their look: texture coordinates, materials, pictures and parts, of garments and avatars alike."""
