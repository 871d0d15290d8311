"""How the shipped bodies, garments, avatar and motion are made from public packages."""
