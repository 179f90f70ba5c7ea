"""The parts of a run for use on their own, with the options of the command line as keyword arguments.

detector, tracker = tr.Detector("road"), tr.Tracker()
ranger = tr.StereoRanger(tr.load_rig("rig.yaml"))
tracks = tracker.update(detector.detect(left), time_s=0.0, image=left)
ranges = ranger.measure(tracks, tr.Frame(index=0, time_s=0.0, left=left, right=right))
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from track_range.detection.detections import Detections
from track_range.detection.models.download import pull
from track_range.detection.models.lookup import DEFAULT_MODEL, find_model, models_folder
from track_range.detection.models.onnx_session import Device, Runtime
from track_range.foundation.arrays import Image
from track_range.run.detector_options import DetectorOptions, open_detector
from track_range.run.tracker_options import open_tracker_options
from track_range.stereo.geometry.rig import RigError, StereoRig
from track_range.stereo.rig_formats.reading import load_calibration
from track_range.tracking.registry import checked_tracks, create_tracker
from track_range.tracking.tracks import Tracks


def load_rig(path: str | Path, *, size_px: tuple[int, int] | None = None, is_grey: bool = False) -> StereoRig:
    """The pair of cameras of a calibration file: rig.yaml, KITTI's calib.txt, OpenCV's or Kalibr's.

    Example:
        >>> import track_range as tr
        >>> tr.load_rig("rig.yaml").baseline_m > 0
        True

    Args:
        path: the file.
        size_px: (width, height) of the images; None = the file's own. KITTI's files give none.
        is_grey: whether to take the grey pair of a KITTI file that also has the colour one.

    Raises:
        RigError: the file cannot be read, holds one camera, or gives no image size where none is given here.
    """
    rig, _ = load_calibration(Path(path), size_px=size_px, is_grey=is_grey)
    if not isinstance(rig, StereoRig):
        raise RigError(f"{path}: expected two cameras, found one.")
    if not rig.left.width_px:
        raise RigError(f"{path}: it gives no image size; give size_px=(width, height) of the images.")
    return rig


class Detector:
    """A YOLO detector of road users.

    Example:
        >>> import numpy as np, track_range as tr
        >>> detections = tr.Detector("road").detect(np.zeros((360, 640, 3), np.uint8))
        >>> len(detections), detections.xyxy_px.shape
        (0, (0, 4))
    """

    def __init__(
        self,
        model: str | Path = DEFAULT_MODEL,
        *,
        names: Sequence[str] | None = None,
        anchors: str | None = None,
        letterbox: str | None = None,
        min_score: float | str = 0.1,
        size: int | None = None,
        threads: int = 0,
        device: Device = "auto",
        classes: Sequence[str] = (),
    ) -> None:
        """Load a model, downloading it first where it is a name of the catalogue that is not in the cache.

        Args:
            model: an ONNX file, or a name of `track-range models list`.
            names: class names in the network's order; None = the model's own.
            anchors: anchors of raw YOLO heads, "81,82 135,169 344,319 / 23,27 ..."; None = the model's own.
            letterbox: placement and grey of the padding, such as "centred-114"; None = the family's.
            min_score: confidence below which boxes are dropped: 0.25, or "0.1,car=0.3".
            size: longer side of the network's input, px, where the model leaves it open.
            threads: threads of the network; 0 = one per core.
            device: "auto", "cpu", "cuda" or "tensorrt".
            classes: road classes to detect; empty = all.

        Raises:
            ModelError, DownloadError: the model cannot be used, or not be fetched.
            ClassNameError, ConfigError: a class, name or threshold is wrong.
        """
        options = DetectorOptions(
            names=None if names is None else ",".join(names),
            anchors=anchors,
            letterbox=letterbox,
            min_score=str(min_score),
            size_px=size,
            threads=threads,
            device=device,
            classes=tuple(classes),
        )
        found = find_model(model)
        path = found.path if found.entry is None or found.origin != "catalogue" else pull(found.entry, models_folder())
        self._network = open_detector(path, options)

    @property
    def class_names(self) -> tuple[str, ...]:
        """Names of the network's classes, road classes or not."""
        return tuple(self._network.model.names)

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences on the model: where its class names come from, fall-backs of the device."""
        return self._network.notes

    def detect(self, image: Image) -> Detections:
        """The road users in `image`, (H, W, 3) uint8 BGR, best score first; boxes in its pixels.

        Raises:
            ValueError: the image has another shape or type.
        """
        return self._network.detect(image)


class Tracker:
    """Gives detections of successive frames identities.

    Example:
        >>> import numpy as np, track_range as tr
        >>> tracker = tr.Tracker()
        >>> for index in range(5):
        ...     box = [[100 + 2 * index, 50, 180 + 2 * index, 110]]
        ...     tracks = tracker.update(tr.Detections.of(box, [0.9], [2]), time_s=0.1 * index)
        >>> tracks.track_id.tolist()
        [1]
    """

    def __init__(
        self, name: str = "deepsort", *, reid: str | Path | None = None, threads: int = 0, device: Device = "auto"
    ) -> None:
        """Start without tracks.

        Args:
            name: "deepsort" (motion and appearance), "sort" (motion alone), a registered tracker or `module:Class`.
            reid: an ONNX re-identification network for appearance; None = the built-in descriptor.
            threads: threads of that network; 0 = one per core.
            device: where it runs.

        Raises:
            TrackerError: no tracker of that name.
            ModelError: the re-identification network cannot be used.
        """
        runtime = Runtime(device=device, n_threads=threads)
        options = open_tracker_options(None if reid is None else Path(reid), runtime)
        self._tracker = create_tracker(name, options)

    def update(self, detections: Detections, time_s: float, image: Image | None = None) -> Tracks:
        """The confirmed tracks at `time_s`, in seconds, later than at the last call.

        Args:
            detections: boxes of this frame, in pixels of the image.
            time_s: seconds from the first frame.
            image: (H, W, 3) uint8 BGR for appearance and camera motion; None = boxes alone.

        Raises:
            TrackerError: the tracker of another package returned no Tracks.
        """
        return checked_tracks(self._tracker, self._tracker.update(detections, time_s, image))
