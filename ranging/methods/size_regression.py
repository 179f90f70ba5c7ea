"""SizeRanger: monocular distance from the size and the bottom edge of a box, with a size model per
class.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from track_range.detection.box_errors import BoxErrors
from track_range.detection.boxes import area_px2, intersection_px2
from track_range.foundation.arrays import BoolArray, FloatArray
from track_range.ranging.measurement.ranges import Ranges
from track_range.ranging.methods.method import (
    ErrorSource,
    Measured,
    MethodContext,
    Ranger,
    RangingMethod,
)
from track_range.ranging.size_models.curve import load_curves
from track_range.ranging.size_models.drive_scale import NO_EVIDENCE, DriveScale, ScaleEvidence
from track_range.ranging.size_models.size_model import (
    BORDER_PX,
    BoxNoise,
    BoxTraits,
    DriveState,
    SizeModel,
    have_hidden_sides,
    measured_boxes,
)
from track_range.ranging.world.parallax import Parallax
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.odometry.ego_motion import CameraStep
from track_range.tracking.tracks import Tracks

# lower boxes are not ranged: an edge error of 1 px is a quarter of the distance
_MIN_HEIGHT_PX = 4.0


# relative, of boxes cut at the left or right, whose middle is not the object's; on KITTI
_CUT_SIGMA = 0.085
_MIN_AREA_PX2 = 1e-6  # smallest area of a box, so that one without an area is not covered
# relative, of the distance of a box that nearer ones cover wholly, of a detector on KITTI
_COVERED_SIGMA = 0.06


def incomplete_sigma(xyxy_px: FloatArray, is_cut: BoolArray) -> FloatArray:
    """(N,) relative standard deviation of distances by size because of the parts of objects that
    are not visible.

    Boxes of the frame (N, 4) that end lower in the image are nearer; `is_cut` (N,) is whether the
    left or right side is at the border of the image.
    """
    cut_sigma = np.asarray(_CUT_SIGMA * is_cut, np.float64)
    if len(xyxy_px) < 2:
        return cut_sigma
    bottom_px = xyxy_px[:, 3]
    covered_px2 = intersection_px2(xyxy_px, xyxy_px)
    covered_px2 *= bottom_px > bottom_px[:, None]
    covered = np.maximum.reduce(covered_px2, axis=1)
    covered /= np.maximum(area_px2(xyxy_px), _MIN_AREA_PX2)
    return np.asarray(np.hypot(cut_sigma, _COVERED_SIGMA * covered))


class SizeRanger(Ranger):
    """Ranges observed boxes by size, or by height alone if a side is cut or hidden; not boxes cut
    at top or bottom.

    A ranger belongs to one drive: it learns the ground plane and the body types of its tracks
    (`DriveState`).

    Example:
        >>> import numpy as np, track_range as tr
        >>> camera = tr.PinholeCamera(700.0, 700.0, 320.0, 180.0, width_px=640, height_px=360)
        >>> frame = tr.Frame(index=0, time_s=0.0, left=np.zeros((360, 640, 3), np.uint8), right=None)
        >>> box = np.array([[280.0, 170.0, 350.0, 225.0]])  # a car, 55 px high
        >>> tracks = tr.Tracks(np.array([1]), box, np.array([2]), np.array([0.9]), np.array([True]))
        >>> ranges = tr.SizeRanger(camera).measure(tracks, frame)
        >>> 15 < ranges.distance_m[0] < 25
        np.True_
    """

    def __init__(
        self,
        camera: PinholeCamera,
        curves: SizeModel | None = None,
        *,
        box_sigma_px: float | None = None,
        noise: BoxNoise | None = None,
        box_errors: BoxErrors | None = None,
        parallax: Parallax | None = None,
        has_visible_boxes: bool = False,
    ) -> None:
        """Create a ranger for `camera` (undistorted); without curves, with the packaged priors.

        `box_sigma_px` is the standard deviation of all box edges; `noise` overrides it, and without
        both it is typical of a detector. `box_errors` are systematic errors of the detector's
        boxes; None = an unknown detector, or with `box_sigma_px` no such errors. `parallax`
        triangulates static objects, which corrects their tracks. `has_visible_boxes`: boxes end
        where a nearer object begins, as a detector's boxes do.
        """
        self._has_visible_boxes = has_visible_boxes
        self._parallax = parallax
        self._step: CameraStep | None = None
        self._camera = camera
        self._drive = DriveState()
        self._curves = curves or load_curves()
        traits = BoxTraits.of(camera.width_px, box_sigma_px=box_sigma_px, errors=box_errors)
        self._noise, self._errors = noise or traits.noise, traits.errors

    def measure(self, tracks: Tracks, frame: Frame) -> Ranges:
        """Distances by size; NaN for predicted boxes, boxes truncated at top or bottom, and classes
        without a model.
        """
        return self.measure_at_scale(tracks, frame, {}, NO_EVIDENCE).ranges

    def measure_at_scale(
        self, tracks: Tracks, frame: Frame, others: Mapping[str, Ranges], scale: DriveScale
    ) -> Measured:
        """See `measure`; corrected by the scale of the drive and by the triangulation of static
        objects.

        The triangulated distances are evidence of the scale; distances triangulated in this frame
        already correct their own tracks.
        """
        by_size = self._by_size(tracks, frame)
        step, self._step = self._step, None
        evidence = ScaleEvidence(tracks.class_id, by_size)
        if self._parallax is not None:
            static = self._parallax.measure(tracks, step, scale.expected(by_size, tracks.class_id))
            # in a frame between two that are compared, nothing is triangulated
            if step is not None and step.time_s == frame.time_s:
                evidence = replace(
                    evidence,
                    reference=static,
                    reference_sigma=step.travelled_sigma,
                    corrects_tracks=True,
                )
        return Measured(
            scale.after([evidence], frame.time_s).corrected(by_size, tracks.class_id), evidence
        )

    def _by_size(self, tracks: Tracks, frame: Frame) -> Ranges:
        height_px, width_px = frame.left.shape[:2]
        x1_px, y1_px, x2_px, y2_px = tracks.xyxy_px.T
        first_px, last_x_px, last_y_px = (
            BORDER_PX - 0.5,
            width_px - 0.5 - BORDER_PX,
            height_px - 0.5 - BORDER_PX,
        )
        usable = tracks.observed & (y1_px >= first_px) & (y2_px <= last_y_px)
        usable &= (y2_px - y1_px >= _MIN_HEIGHT_PX) & (x2_px > x1_px)
        rows = usable.nonzero()[0]
        is_cut = (x1_px < first_px) | (x2_px > last_x_px)
        is_whole = ~have_hidden_sides(tracks.xyxy_px) if self._has_visible_boxes else np.True_
        uses_width = ~is_cut & is_whole
        boxes = measured_boxes(
            tracks.xyxy_px[rows],
            tracks.class_id[rows],
            camera=self._camera,
            noise=self._noise,
            errors=self._errors,
            uses_width_bottom=(uses_width[rows], np.ones(len(rows), np.bool_)),
            doubt=(tracks.other_class_id[rows], tracks.other_probability[rows]),
        )
        self._drive.start_frame(tracks.track_id[rows], frame.time_s)
        measured = self._curves.measure(boxes, self._drive)
        incomplete_m = measured.distance_m * incomplete_sigma(tracks.xyxy_px, is_cut)[rows]
        distance_m, sigma_m, systematic_m = np.full((3, len(tracks)), np.nan)
        distance_m[rows] = measured.distance_m
        sigma_m[rows] = np.hypot(measured.sigma_m, incomplete_m)
        systematic_m[rows] = np.hypot(measured.sigma_systematic_m, incomplete_m)
        return Ranges(tracks.track_id, distance_m, sigma_m, systematic_m)

    def update_motion(self, step: CameraStep) -> None:
        """Triangulate static objects of the next frame from the motion of the camera."""
        self._step = step


def _create(context: MethodContext) -> Ranger:
    return SizeRanger(
        context.camera,
        context.size_model,
        box_sigma_px=context.box_sigma_px,
        box_errors=context.box_errors,
        parallax=Parallax(context.camera) if context.has_images and context.rig is None else None,
        has_visible_boxes=context.has_visible_boxes,
    )


MONO = RangingMethod(
    name="mono",
    title="mono",
    letter="M",
    colour="#cf7410",
    create=_create,
    error_sources=(
        ErrorSource("size", systematic=0.24),
        ErrorSource("drive_scale", systematic=0.24),
        # The bottom edge is a part of the evidence, on a road that the other sizes show: with the
        # poses of KITTI's 13 sequences as motion, track means of `mono` and `ground` have a
        # correlation of 0.47 to 0.58, and their views one of 0.42 to 0.55.
        ErrorSource("horizon", systematic=0.09),
        ErrorSource("box_height", independent=0.36 * 5 / 7),
        ErrorSource("contact_point", systematic=0.07, independent=0.36 * 2 / 7),
    ),
    is_filtered=True,
)
