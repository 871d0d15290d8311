"""A training run: schedule, steps, validation, checkpoints, several GPUs."""
