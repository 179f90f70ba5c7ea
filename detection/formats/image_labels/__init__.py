"""Labels of single images: data sets for training and evaluation, and rows of YOLO label files."""
