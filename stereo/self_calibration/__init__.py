"""Self-calibration: lens and focal length of one camera from the motion of the static scene."""
