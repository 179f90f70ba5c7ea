"""Textures of vehicles, roads and scenery."""
