"""The networks in torch, how they drape a garment, and their way into a model file and back."""
