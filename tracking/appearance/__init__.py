"""Appearance of tracked objects: embeddings, the gallery of each track, and re-identification
networks.
"""
