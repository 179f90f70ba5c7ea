"""Stereo: matching of boxes, occlusion, and the alignment of the rig."""
