"""Calibration of a camera from its own drives: motion of the static scene, road users, known
metres, speed, and the metadata of the file.
"""
