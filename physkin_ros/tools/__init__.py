"""The demo and the benchmark of the node: a player, a listener and the node in processes of their own."""
