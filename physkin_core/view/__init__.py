"""The page of `physkin view`: an avatar and its outfit, live in a browser (extra `[view]`)."""
