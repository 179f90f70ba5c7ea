"""Evaluation of collision warnings against contacts, and of events against labelled events."""
