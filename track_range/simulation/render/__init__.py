"""Rendering of the simulated world: textured faces, depth buffer, night lighting."""
