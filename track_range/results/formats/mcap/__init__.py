"""run.mcap: the tracks of a run for Foxglove, or for ROS 2."""

from pathlib import Path

LAYOUT = Path(__file__).with_name("foxglove_layout.json")
"""Layout for Foxglove: image with boxes, 3-D scene, plots of distance and closing speed, notes."""
