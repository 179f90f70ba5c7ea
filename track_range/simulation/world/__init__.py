"""The simulated world: roads, road users with their textured bodies, and exact ground truth."""
