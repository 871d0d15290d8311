"""What a frame looks like as a message."""
