"""Report of a fleet: figures over all clips, tables and one HTML page."""
