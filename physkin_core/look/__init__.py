"""What avatars and garments look like: materials, texture places, and colours read off pictures."""
