"""Data sets of others in the layout of recordings and truth that the evaluations read: one module
for each.
"""
