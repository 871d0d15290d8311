"""A separate process for work that may crash it: requests go in, plain values and arrays come out."""
