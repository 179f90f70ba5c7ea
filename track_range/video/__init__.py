"""Reading videos, image folders, pairs and live streams; writing videos."""
