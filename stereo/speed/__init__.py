"""The speed of the vehicle as it is given: its values, and their error by the images."""
