"""Label and box files: the formats, their readers, the neutral table of boxes, and recorded
detections.
"""
