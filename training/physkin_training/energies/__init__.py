"""The energies of cloth, one in each file: value, gradient and second derivative, as Warp kernels."""
