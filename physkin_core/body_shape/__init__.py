"""What a body is shaped like: its limbs, its skin by part, and its trunk as a smooth surface."""
