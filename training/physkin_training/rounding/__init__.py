"""Networks rounded to as few steps as figures allow."""
