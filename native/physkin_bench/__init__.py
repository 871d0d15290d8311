"""`physkin bench`: the native evaluator against its peers and against what the machine can do, in one run.

Peers are imported only when it runs; those that are not installed are named and left out.
"""

from physkin_bench.command import command_parser, main

__all__ = ["command_parser", "main"]
