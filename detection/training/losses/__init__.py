"""The detection loss: assignment of objects to anchors, and losses of boxes, objectness and
classes.
"""
