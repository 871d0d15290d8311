"""What messages say of an avatar's root: which way gravity points in it, how it moves, and where it is in the world."""
