"""Physics around the energies: rest shapes, contact with bodies, the losses of training and the minimisers."""
