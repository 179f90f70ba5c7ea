"""Focal length, height and pitch of one camera from known distances and sizes in its video."""
