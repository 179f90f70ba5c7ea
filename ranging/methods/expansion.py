r"""ExpansionRanger: time to collision from the growth of an object in the image, without distances
and focal length.

An object at the distance d with the size s in the image has s ~ 1 / d, so that its growth gives the
time to collision (Lee, A theory of visual control of braking based on information about
time-to-collision, Perception 1976)

    T = d / -d' = s / s'

The filter of distances (`distance_filter`) estimates T, with d = 1 / s in the unit in which objects
of the class have their typical size. It has two measurements: the size of the box in every frame,
and the growth of its patch in the images since a key frame (`patch_scale`), which is tens of times
as precise. The typical size and the focal length only set what changes of speed are likely. The
growth is also a measurement for the filters of distances (`Ranges.growth`).
"""

import numpy as np

from track_range.detection.classes import ROAD_CLASSES
from track_range.foundation.arrays import IntArray
from track_range.ranging.filtering.cut_boxes import CutBoxes
from track_range.ranging.filtering.distance_filter import DistanceFilters, FilterSettings
from track_range.ranging.filtering.lateral_motion import sides_cut
from track_range.ranging.filtering.observation import Observation
from track_range.ranging.measurement.ranges import Ranges
from track_range.ranging.methods.method import MethodContext, Ranger, RangingMethod
from track_range.ranging.methods.patch_scale import WIDTH_M, PatchScales, side_fraction
from track_range.ranging.size_models.size_model import BORDER_PX, BoxNoise, detector_noise
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.frames import Frame
from track_range.tracking.tracks import Tracks

_HEIGHT_M = np.array([1.7, 1.7, 1.5, 1.5, 3.0, 3.0, 0.9, 0.7])  # typical height by road class
_LOG_SIZE = np.log(np.stack([WIDTH_M, _HEIGHT_M], axis=1))  # (road classes, 2)
# relative standard deviation of sizes in a class: step where a box begins to count by height only
_SIZE_SIGMA = 0.15
# largest fraction of the width that may be an object's side; it grows faster than the object
_MAX_SIDE = 0.25
_RIGID = np.isin(ROAD_CLASSES, ("car", "bus", "truck", "traffic sign"))  # whose widths count
_MIN_HEIGHT_PX = 4.0
_MAX_SIGMA = 0.3  # largest relative standard deviation of a time to collision


class ExpansionRanger(Ranger):
    """Times to collision from boxes and, if frames have pixels, from the images; it measures no
    distance.

    Example:
        >>> import numpy as np, track_range as tr
        >>> from track_range.ranging.methods.expansion import ExpansionRanger
        >>> camera = tr.PinholeCamera(700.0, 700.0, 320.0, 180.0, width_px=640, height_px=360)
        >>> ranger, image = ExpansionRanger(camera, has_images=False), np.zeros((360, 640, 3), np.uint8)
        >>> for i in range(20):  # a car, 30 m away, that comes nearer by 10 m/s
        ...     half = np.array([1.7, 1.5]) * 350.0 / (30.0 - 0.1 * 10.0 * i)
        ...     box = np.concatenate([[320.0, 180.0] - half, [320.0, 180.0] + half])[None]
        ...     tracks = tr.Tracks(np.array([1]), box, np.array([2]), np.array([0.9]), np.array([True]))
        ...     ranges = ranger.measure(tracks, tr.Frame(index=i, time_s=0.1 * i, left=image, right=None))
        >>> 0.9 < ranges.details["ttc_s"][0] < 1.3
        np.True_
    """

    def __init__(
        self, camera: PinholeCamera, *, noise: BoxNoise | None = None, has_images: bool = True
    ) -> None:
        """Create a ranger for `camera` (undistorted); `noise` of box edges: None = typical of a
        detector.
        """
        self._camera = camera
        self._noise = noise or detector_noise(camera.width_px)
        self._scales = PatchScales(camera) if has_images else None
        self._filter = DistanceFilters({"": 1.0}, FilterSettings(max_rate_sigma_mps=np.inf))

    def measure(self, tracks: Tracks, frame: Frame) -> Ranges:
        """Times to collision of the tracks and their sigmas as details, and the growth; without
        distances.
        """
        growth = (
            None if self._scales is None else self._scales.measure(tracks, frame.left, frame.time_s)
        )
        by_size, condition = self._by_size(tracks)
        filtered = self._filter.update(
            {"": by_size},
            frame.time_s,
            observation=Observation(
                conditions={"": condition},
                cut=CutBoxes.of(tracks, self._camera),
                growth=growth,
            ),
        )[""]
        is_known = filtered.ttc_sigma_s < _MAX_SIGMA * filtered.ttc_s
        details = {
            "ttc_s": np.where(is_known, filtered.ttc_s, np.nan),
            "ttc_sigma_s": np.where(is_known, filtered.ttc_sigma_s, np.nan),
        }
        nan = np.full(len(tracks), np.nan)
        return Ranges(tracks.track_id, nan, nan, details=details, growth=growth)

    def _by_size(self, tracks: Tracks) -> tuple[Ranges, IntArray]:
        """Distances of N tracks by the typical sizes of their classes, and (N,) which sides of the
        boxes they use.
        """
        camera, class_id = self._camera, tracks.class_id
        x1, y1, x2, y2 = tracks.xyxy_px.T
        size_px = tracks.xyxy_px[:, 2:] - tracks.xyxy_px[:, :2]
        last_y_px = camera.height_px - 0.5 - BORDER_PX if camera.height_px > 0 else np.inf
        is_usable = tracks.observed & (np.minimum.reduce(size_px, axis=1) >= _MIN_HEIGHT_PX)
        is_usable &= (y1 >= BORDER_PX - 0.5) & (y2 <= last_y_px)
        is_cut_left, is_cut_right = sides_cut(tracks, camera)
        uses_width = _RIGID[class_id] & ~(is_cut_left | is_cut_right)
        uses_width &= side_fraction(camera, (x1 + x2) / 2, class_id) < _MAX_SIDE
        n_sides = 1 + uses_width
        # boxes without a size are not usable
        size_px = np.maximum(size_px, _MIN_HEIGHT_PX)
        log_m = _LOG_SIZE[class_id] - np.log(size_px / (camera.fx_px, camera.fy_px))
        log_mean = (uses_width * log_m[:, 0] + log_m[:, 1]) / n_sides
        distance_m = np.where(is_usable, np.exp(log_mean), np.nan)
        edges = (self._noise.sigma_px(size_px, class_id) / size_px) ** 2
        # two edges per side
        by_edges = 2 * (uses_width * edges[:, 0] + edges[:, 1]) / n_sides**2
        sigma = np.sqrt(by_edges + _SIZE_SIGMA**2)
        by_size = Ranges(tracks.track_id, distance_m, distance_m * sigma, distance_m * _SIZE_SIGMA)
        return by_size, uses_width.astype(int)


def _create(context: MethodContext) -> Ranger:
    noise = None if context.box_sigma_px is None else BoxNoise(context.box_sigma_px, 0.0, 0.0)
    return ExpansionRanger(context.camera, noise=noise, has_images=context.has_images)


EXPANSION = RangingMethod(
    name="expansion",
    title="expansion",
    letter="E",
    colour="#7a5bc7",
    create=_create,
    error_sources=(),
    measures_distance=False,
    details={
        "ttc_s": "time to collision by [expansion], without distance and focal length; empty = not "
        "approaching, or uncertain",
        "ttc_sigma_s": "its standard deviation",
    },
)
