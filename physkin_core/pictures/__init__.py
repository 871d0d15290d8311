"""Pictures of bodies and garments, drawn on the CPU: the scene, the stitches painted on it, sheets of several."""
