"""Workloads that measure distances, and what they depend on: stereo, alignment, camera height and
motion.
"""
