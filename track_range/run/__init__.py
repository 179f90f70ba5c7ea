"""A run: settings, pipeline, session and output folder."""
