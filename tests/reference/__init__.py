"""The method once more, in NumPy and float64: what the native evaluator and torch are held to. Clear before fast.

A file a concept, in the order of a frame: `frame_input`, of `root_tracker`; `skeleton`, `networks`, `sway_network`,
`garment_nodes`, `pace`, `contact`, `skinning`; `layer_order`; `frame`, of all of them.
`unfolded_frame` is the paper's chain with nothing folded at binding. `hyper_modulator` encodes a body,
`limb_separator` filters poses. Of the product only what holds data is imported, and constants are stated anew: where
the two differ, a test fails.

Everywhere: `d` degrees of freedom, `b` bones, `m` garment nodes, `n` garment vertices, `K` influences a vertex. Metres,
seconds, radians, root frame.
"""
