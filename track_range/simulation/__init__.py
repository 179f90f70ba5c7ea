"""A road of moving objects seen by two eyes, with exact truth."""
