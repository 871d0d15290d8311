"""What the page of `physkin view` shows, without a browser: who wears what, in which pose, and how well."""
