"""Tracking: identities for the boxes of successive frames."""
