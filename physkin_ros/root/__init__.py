"""What messages tell about an avatar's root: where gravity points, how the root moves, where it is in the world."""
