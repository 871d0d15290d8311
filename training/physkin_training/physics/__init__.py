"""The physics: energies and their gradients in Warp, contact, Hessians, the minimiser of the full mesh."""
