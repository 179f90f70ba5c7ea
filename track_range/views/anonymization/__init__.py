"""Anonymization: heads and number plates are made unrecognisable in the images of results."""
