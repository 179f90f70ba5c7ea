"""Detector, tracker and calibration files for separate use, with the options of the command line as
keyword arguments.

detector, tracker = tr.Detector("road"), tr.Tracker()
ranger = tr.StereoRanger(tr.load_rig("rig.yaml"))
tracks = tracker.update(detector.detect(left), time_s=0.0, image=left)
ranges = ranger.measure(tracks, tr.Frame(index=0, time_s=0.0, left=left, right=right))
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypedDict, Unpack

from rich.console import Console

from track_range.detection.catalogue.lookup import DEFAULT_MODEL
from track_range.detection.detections import Detections
from track_range.detection.models.devices import Device
from track_range.detection.models.onnx_session import Runtime
from track_range.detection.yolo.detector import YoloSettings
from track_range.foundation.arrays import Image
from track_range.foundation.schemas.keywords import KeywordsInErrors
from track_range.recording import recording
from track_range.recording.cameras.calibration import names_of
from track_range.run.options.opened import DetectorOptions, open_detector, open_tracker_options
from track_range.run.options.settings import RunSettings
from track_range.run.ready_model import ready_model
from track_range.stereo.geometry.rig import RigError, StereoRig
from track_range.stereo.rig_formats.reading import load_calibration, missing_camera
from track_range.tracking.registry import checked_tracks, create_tracker
from track_range.tracking.tracks import Tracks

open_recording = KeywordsInErrors(RunSettings)(recording.open_recording)


def load_rig(
    path: str | Path,
    *,
    size_px: tuple[int, int] | None = None,
    is_grey: bool = False,
    camera: Sequence[str] = (),
) -> StereoRig:
    """Stereo rig of a calibration file: rig.yaml, or a format of cameras, scripts and data sets.

    Example:
        >>> import track_range as tr
        >>> tr.load_rig("rig.yaml").baseline_m > 0
        True

    Args:
        path: calibration file.
        size_px: (width, height) of the images; None = as in the file. KITTI's files do not contain
            it.
        camera: names of the left and the right camera in a file of several.
        is_grey: whether to use the grey pair of a KITTI file that also has a colour pair.

    Raises:
        RigError: the file cannot be read, contains a single camera, or has no image size and
            `size_px` is None.
    """
    rig, _ = load_calibration(
        Path(path), size_px=size_px, is_grey=is_grey, cameras=names_of(camera)
    )
    if not isinstance(rig, StereoRig):
        raise RigError(f"{path}: expected {missing_camera(Path(path))}, found one camera.")
    if not rig.left.width_px:
        raise RigError(f"{path}: expected an image size, found none; give size_px=(width, height).")
    return rig


class DetectorKeywords(TypedDict, total=False):
    """Options of a `Detector` by keyword, as those of `DetectorOptions`."""

    names: Sequence[str] | None
    anchors: str | None
    letterbox: str | None
    layout: str | None
    min_score: float | str
    size: int | str | None
    threads: int
    device: Device
    classes: Sequence[str]


class Detector:
    """A YOLO detector of road users.

    Example:
        >>> import numpy as np, track_range as tr
        >>> detections = tr.Detector("road").detect(np.zeros((360, 640, 3), np.uint8))
        >>> len(detections), detections.xyxy_px.shape
        (0, (0, 4))
    """

    def __init__(
        self, model: str | Path = DEFAULT_MODEL, **options: Unpack[DetectorKeywords]
    ) -> None:
        """Load a model; a model of the catalogue is downloaded to the cache folder first.

        Args:
            model: an ONNX file, or a name from `track-range models list`.
            options: `names`, class names in the order of the network, by default those in the model
                file; `anchors` of raw YOLO heads, "81,82 135,169 344,319 / 23,27 ...", by default
                as in the model file; `letterbox`, placement of the image and grey level of the
                padding, such as "centred-114", by default as usual for the network family;
                `layout`, name of the layout of the outputs (docs/how-to/detectors.md), by default
                by their shapes and values; `min_score`, minimum confidence of boxes, by default
                0.1, or "0.1,car=0.3"; `size`, longer side of the network input in px, or
                "960x544", for a network of variable input size; `threads`, CPU threads of the
                network, by default one per core; `device`, "auto", "cpu", "cuda", "tensorrt",
                "openvino", "coreml" or "directml"; `classes`, road classes to detect, by default
                all.

        Raises:
            ModelError, DownloadError: the model cannot be used or downloaded.
            ClassNameError, ConfigError: a class, name or threshold is invalid.
            TypeError: there is no such option.
        """
        self._network = open_detector(
            ready_model(model, Console(quiet=True)), _detector_options(options)
        )

    @property
    def class_names(self) -> tuple[str, ...]:
        """Names of all classes of the network."""
        return tuple(self._network.model.names)

    @property
    def notes(self) -> tuple[str, ...]:
        """Messages about the model, such as the source of its class names or a fallback to the
        CPU.
        """
        return self._network.notes

    def detect(self, image: Image) -> Detections:
        """Road users in `image`, (H, W, 3) uint8 BGR, highest score first; boxes in pixels of the
        image.

        Raises:
            ValueError: the image has another shape or type.
        """
        return self._network.detect(image)


def _detector_options(keywords: DetectorKeywords) -> DetectorOptions:
    """The options as on the command line."""
    options: dict[str, Any] = {**keywords}
    names = options.pop("names", None)
    return DetectorOptions(
        names=None if names is None else ",".join(names),
        min_score=str(options.pop("min_score", YoloSettings().min_score)),
        size_px=options.pop("size", None),
        classes=tuple(options.pop("classes", ())),
        **options,
    )


class Tracker:
    """Multi-object tracker: assigns identities to the detections of successive frames.

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
        self,
        name: str = "road",
        *,
        reid: str | Path | None = None,
        threads: int = 0,
        device: Device = "auto",
    ) -> None:
        """Create a tracker without tracks.

        Args:
            name: "road" (appearance near the prediction, then overlap), "deepsort" (appearance in a
                wide gate first), "sort" (no appearance), a registered tracker or `module:Class`.
            reid: an ONNX re-identification network for appearance; None = the built-in descriptor.
            threads: CPU threads of that network; 0 = one per core.
            device: device that runs that network.

        Raises:
            TrackerError: there is no such tracker.
            ModelError: the re-identification network cannot be used.
        """
        runtime = Runtime(device=device, n_threads=threads)
        options = open_tracker_options(None if reid is None else Path(reid), runtime)
        self._tracker = create_tracker(name, options)

    def update(self, detections: Detections, time_s: float, image: Image | None = None) -> Tracks:
        """Confirmed tracks after an update with the detections of one frame.

        Args:
            detections: boxes of this frame, in pixels of the image.
            time_s: seconds from the first frame; must increase from call to call.
            image: (H, W, 3) uint8 BGR, for appearance and camera motion; None = boxes only.

        Raises:
            TrackerError: the tracker of another package did not return Tracks.
        """
        return checked_tracks(self._tracker, self._tracker.update(detections, time_s, image))
