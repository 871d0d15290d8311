"""Outfits: garments worn over each other, from the layers at rest to the order that every frame keeps."""
