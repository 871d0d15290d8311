"""Trains a folder of garments on a Ray cluster: the plan, each garment, the cluster, the page."""
