"""Models of object sizes, which give the distance of a box from its size."""
