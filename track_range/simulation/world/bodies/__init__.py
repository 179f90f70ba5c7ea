"""Bodies of road users, signs and plates, made of textured faces."""
