"""The networks in torch, how they drape a garment, and how they are written to a model file and read."""
