"""Rounds networks as coarsely as the figures allow."""
