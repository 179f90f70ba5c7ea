"""Calibration of one camera from its own drives: known metres, road users, and the metadata of the
file.
"""
