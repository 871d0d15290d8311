"""What training and evaluation draw from: poses, bodies, and pairs of the two."""
