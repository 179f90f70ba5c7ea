"""Writing of videos."""
