"""Moves arms and legs out of the trunk and out of each other, with the smallest change of joint positions."""
