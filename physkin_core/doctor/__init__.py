"""What `physkin doctor` looks at: whether this installation works, and what to do if it does not."""
