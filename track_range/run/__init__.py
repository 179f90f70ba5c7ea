"""A run: settings, pipeline and session."""
