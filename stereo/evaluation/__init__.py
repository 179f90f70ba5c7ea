"""Errors of stereo matchers against true disparities."""
