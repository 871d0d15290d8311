"""The paper's garment model: garment, garment nodes, the three networks, skinning, and the file that holds them."""
