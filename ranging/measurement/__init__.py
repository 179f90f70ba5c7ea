"""What one method measures in a frame: distances, and growth in the images."""
