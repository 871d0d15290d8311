"""From a sewing pattern to a garment: read, triangulated, hung about the body, sewn and relaxed."""
