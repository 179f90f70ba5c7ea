"""Schemas: options and structured files as pydantic models, their versions and keywords."""
