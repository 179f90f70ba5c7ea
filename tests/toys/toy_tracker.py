"""A tracker of another package: each box goes to the track that it overlaps most; ids count from
101."""

import numpy as np

from track_range.detection.boxes import iou
from track_range.tracking.tracks import Tracks


class GreedyIouTracker:
    def __init__(self, options):
        # of track 101, 102, ... in the frame where it was last detected
        self._boxes = np.zeros((0, 4))

    def update(self, detections, time_s, image):
        track_id = np.zeros(len(detections), np.int64)
        overlap = iou(detections.xyxy_px, self._boxes)
        for i in np.argsort(-detections.score, kind="stable"):
            best = int(overlap[i].argmax()) if overlap.size else -1
            if best < 0 or overlap[i, best] < 0.3:
                best, self._boxes = (
                    len(self._boxes),
                    np.vstack([self._boxes, detections.xyxy_px[i]]),
                )
            else:
                overlap[:, best] = 0.0
            self._boxes[best], track_id[i] = detections.xyxy_px[i], 101 + best
        observed = np.ones(len(detections), np.bool_)
        return Tracks(track_id, detections.xyxy_px, detections.class_id, detections.score, observed)


class NotATracker:
    def __init__(self, options):
        pass


class TakesNothing:
    pass


NOT_CALLABLE = 5
