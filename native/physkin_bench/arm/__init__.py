"""Cycles of a frame on ARM processors that are not at hand: counted under qemu, timed by llvm-mca's models."""
