"""The application: flags, files, reports and clocks."""
