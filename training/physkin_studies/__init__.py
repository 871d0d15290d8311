"""Studies: experiments that a figure in the docs comes from. Run from a clone, not installed."""
