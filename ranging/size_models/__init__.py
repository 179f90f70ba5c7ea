"""Distance from the size of a box: models of object sizes."""
