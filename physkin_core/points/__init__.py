"""Other representations of a garment, carried by its trained garment nodes: meshes, point clouds, Gaussian splats."""
