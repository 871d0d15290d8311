"""Turns frames into messages."""
