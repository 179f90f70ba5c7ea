"""What there is: roads, road users, what they are made of, and the exact truth about them."""
