"""Bodies, garments and motion read by a process of their own: a damaged or endless file costs a request, no more."""
