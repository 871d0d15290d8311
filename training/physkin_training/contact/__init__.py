"""Contact of cloth with a body: closest points and rays on its surface, and what of it a garment is worn on."""
