"""Images of the world: faces, textures, depth buffer."""
