"""A training run: schedule, steps, validation, checkpoints, export."""
