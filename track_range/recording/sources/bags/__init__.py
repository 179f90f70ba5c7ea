"""Images and calibrations in MCAP files and ROS bags."""
