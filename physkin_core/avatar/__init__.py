"""Avatars: bodies read from files or made by the body model, brought into the canonical pose and bound to the rig."""
