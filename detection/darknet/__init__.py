"""The importer of Darknet's .cfg and .weights files."""
