"""Formats of the labels of one video: KITTI, MOTChallenge, CSV, COCO, CVAT for video, and folders
of YOLO labels.
"""
