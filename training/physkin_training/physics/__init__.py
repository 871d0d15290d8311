"""Physics around the energies: the losses of training, and the minimisers."""
