"""What the page of `physkin view` shows, apart from the browser: who wears what, in which pose, and how well."""
