"""Reading and writing of files: atomic and locked writing, limits on what is read, CSV, YAML, JSON,
images, arrays.
"""
