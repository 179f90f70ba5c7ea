"""Data that the report embeds for the script of its page."""
