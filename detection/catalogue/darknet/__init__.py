"""Import of Darknet's .cfg and .weights files."""
