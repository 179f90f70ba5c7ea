"""Storage of a fleet: local folders, object stores and web servers."""
