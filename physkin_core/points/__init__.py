"""Other meshes, point clouds and Gaussian splats that a garment's trained garment nodes move."""
