"""The networks that can be trained, by name, with their default anchors."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from track_range.detection.models.metadata import Anchors
from track_range.detection.training.networks.network import DetectionNetwork
from track_range.detection.training.networks.road_net import RoadNet
from track_range.detection.training.networks.yolov4_tiny import DEFAULT_ANCHORS_PX as YOLOV4_TINY_ANCHORS_PX
from track_range.detection.training.networks.yolov4_tiny import YoloV4Tiny
from track_range.detection.training.networks.yolov5 import COCO_ANCHORS_PX, YoloV5


@dataclass(frozen=True, slots=True)
class NetworkKind:
    """A network that can be trained."""

    family: str  # name for display
    make: Callable[..., DetectionNetwork]  # function that creates the network
    anchors_px: Anchors = ()  # default anchors of each head in input pixels; empty for a network without anchors

    @property
    def n_heads(self) -> int:
        """Number of heads."""
        return len(self.anchors_px)

    @property
    def n_anchors(self) -> int:
        """Number of anchors of all heads."""
        return sum(len(head) for head in self.anchors_px)


NETWORKS: Mapping[str, NetworkKind] = {
    "road": NetworkKind("RoadNet", RoadNet),
    "yolov5n": NetworkKind("YOLOv5n", YoloV5, COCO_ANCHORS_PX),
    "yolov5s": NetworkKind("YOLOv5s", YoloV5, COCO_ANCHORS_PX),
    "yolov4-tiny": NetworkKind("YOLOv4-tiny", YoloV4Tiny, YOLOV4_TINY_ANCHORS_PX),
}


def make_network(
    name: str, n_classes: int, *, anchors_px: Anchors | None = None, has_cbam: bool = False
) -> DetectionNetwork:
    """A network with random weights and, if it has anchors, its default ones unless `anchors_px` are given."""
    kind = NETWORKS[name]
    if not kind.anchors_px:
        return kind.make(name, n_classes, has_cbam=has_cbam)
    return kind.make(name, n_classes, anchors_px=anchors_px or kind.anchors_px, has_cbam=has_cbam)
