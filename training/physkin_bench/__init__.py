"""Benchmarks in a clone, by `make bench`: the evaluator against its peers, which are imported only when it runs."""
