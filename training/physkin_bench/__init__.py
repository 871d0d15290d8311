"""Benchmark in a clone, by `make bench`: the native evaluator in more cases than `physkin bench` has."""
