"""Recordings of one camera: video files, folders of images, bags, several files, and live sources."""
