"""Distances of tracked objects from boxes, images and geometry: methods, fusion, filters,
evaluation.
"""
