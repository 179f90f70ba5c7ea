"""Visual odometry: rotation and speed of the camera from its images."""
