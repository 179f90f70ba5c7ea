"""The right camera of a pair during a drive: how far it moved, its correction, and a new alignment."""
