"""A sway network: walkers are simulated in the numbers of their garment nodes, and what their clothes do is learnt."""
