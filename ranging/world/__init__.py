"""Ego path and road users in the world: poses, speeds over ground, headings and states of motion."""
