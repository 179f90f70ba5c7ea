"""Errors of matchers against known disparities."""
