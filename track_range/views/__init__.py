"""What people look at: overlay, event clips, report, live view, anonymization, and the writer of videos."""
