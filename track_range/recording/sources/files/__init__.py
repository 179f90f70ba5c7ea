"""Video files and folders of numbered images as sequences of frames."""
