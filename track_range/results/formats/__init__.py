"""Result writers, one module per format, and the readers of their files."""
