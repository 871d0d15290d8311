"""A folder of garments trained on a Ray cluster: planning, one garment, the cluster, the page."""
