"""From one frame to its result: detection, tracking, ego motion, ranging, fusion, filters and
warning.
"""
