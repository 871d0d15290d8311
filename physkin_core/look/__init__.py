"""What avatars and garments look like: materials, texture coordinates, and colours taken from pictures."""
