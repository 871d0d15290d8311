"""A garment of one's own: checked, mended, laid on the body, trained and reported on."""
