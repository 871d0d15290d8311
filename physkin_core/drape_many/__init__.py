"""`physkin drape-many`: a table or folders of avatars and motions, each row draped into a folder of its own."""
