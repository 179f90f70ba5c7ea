"""The detection loss: assignment of anchors to objects, box and class losses."""
