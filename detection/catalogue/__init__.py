"""Models by name: the catalogue of public detectors, their download, and the import of Darknet's
files.
"""
