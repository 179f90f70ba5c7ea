"""Label and box files: the formats, the neutral table of boxes, recorded detections, and boxes of
other libraries.
"""
