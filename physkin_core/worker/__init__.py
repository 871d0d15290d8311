"""A process of its own for work that may end it: requests go in, plain values and arrays come out."""
