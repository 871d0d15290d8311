"""How garments sit on an avatar, before anyone has seen them move."""
