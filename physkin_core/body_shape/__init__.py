"""What a body is shaped like: its limbs, its skin by part, and parts of it as smooth surfaces."""
