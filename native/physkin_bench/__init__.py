"""Benchmarks: the evaluator against its peers and what the machine can do, the node between real processes.

Peers are imported only when it runs; those that are not installed are named and left out.
"""
