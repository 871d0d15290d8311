"""The energies of cloth, one a file: value, gradient and second derivative, as Warp kernels written by hand."""
