"""An ensemble of detectors as the teacher of another detector: pseudo-labels with calibrated
probabilities.

`views` runs the detectors, `fusion` groups their boxes, `calibration` turns their scores into the
probability of an object, and `data_set` selects the boxes that supplement the labels of an image.
"""
