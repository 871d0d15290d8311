"""Many rows of work on one machine or on a Ray cluster, resumed after a stop, with a page of progress."""
