"""Evaluation of closing speed, speed over ground, time to collision and warnings against labelled
motion.
"""
