"""The neutral table of boxes that all label formats are read into, and the checks that they
share.
"""
