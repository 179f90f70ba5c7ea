"""Workloads on detections, lanes, label formats and covered regions of images."""
