"""Lane lines: detection by networks or by edges, and the choice of the own lane."""
