"""NetworkDepthRanger: distance by the depths that a network gives for the pixels of one image.

The network measures in a background thread. Its distances are corrected by what the drive shows of
its errors (`NetworkScale`).
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Protocol

import numpy as np

from track_range.foundation.arrays import FloatArray, Image
from track_range.foundation.errors import Note
from track_range.ranging.measurement.dense_map import DenseMap
from track_range.ranging.measurement.dense_surfaces import box_surfaces
from track_range.ranging.measurement.ranges import Ranges
from track_range.ranging.measurement.relative_depth import RelativeFit
from track_range.ranging.measurement.rig_scale import RigScale
from track_range.ranging.methods.dense_ranger import DenseMapRanger
from track_range.ranging.methods.method import (
    ErrorSource,
    Measured,
    MethodContext,
    MethodError,
    OpenedNetwork,
    Ranger,
    RangingMethod,
)
from track_range.ranging.size_models.drive_scale import NO_EVIDENCE, DriveScale
from track_range.ranging.size_models.network_scale import (
    FREE_SIGMA,
    NetworkDistances,
    NetworkErrors,
    NetworkScale,
)
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.frames import Frame
from track_range.tracking.tracks import Tracks

_NAME = "depth"
_PAIR = "stereo"
_REFERENCES = (_PAIR, "mono")  # for networks that are right up to scale and shift


class DepthSource(OpenedNetwork, Protocol):
    """An open network, or what measures like one."""

    def measure(self, image: Image, fx_px: float) -> DenseMap:
        """The depth of an image (H, W, 3) in BGR, of a camera with this focal length."""


class NetworkDepthRanger(DenseMapRanger):
    """Ranges each box by the depth of the surface at its centre."""

    def __init__(
        self,
        name: str,
        network: DepthSource,
        camera: PinholeCamera,
        errors: NetworkErrors | None = None,
    ) -> None:
        """Start a ranger of the method `name`; `errors` are measured ones of the network, None =
        those of any network.
        """
        super().__init__(name)
        self._name, self._source, self._camera = name, network, camera
        self.network = network
        self._errors = errors or NetworkErrors()
        self._relative = RelativeFit()

    def map_of(self, frame: Frame) -> DenseMap:
        """The depths of a frame, as the network gives them."""
        return self._source.measure(frame.left, self._camera.fx_px)

    def measure(self, tracks: Tracks, frame: Frame) -> Ranges:
        """Distances of observed boxes, with the sigma of a network before any evidence."""
        return self.measure_at_scale(tracks, frame, {}, NO_EVIDENCE).ranges

    def measure_at_scale(
        self, tracks: Tracks, frame: Frame, others: Mapping[str, Ranges], scale: DriveScale
    ) -> Measured:
        """Distances as the drive before this frame corrects them, and those of the network."""
        depths = self.dense_map(frame)
        if depths is None:
            return Measured(Ranges.unmeasured(tracks.track_id))
        values, sigmas = box_surfaces(depths, tracks.xyxy_px)
        values = np.where(tracks.observed, values, np.nan)
        errors = self._errors
        if not depths.is_metric:
            if depths.quantity == "inverse_depth":
                return Measured(self._by_others(tracks, values, sigmas, others, frame.time_s))
            errors = errors.model_copy(update={"drive_sigma": FREE_SIGMA})  # right up to a factor
        raw = _raw(tracks, depths, values, sigmas)
        if _PAIR in others:  # which is some ten times as precise, and corrects the sizes
            raw = replace(raw, is_fallback=True)
        before = NetworkScale(errors, errors.log_factor, errors.drive_sigma_before)
        drive = scale.network.get(self._name, before)
        # of the pixels: the factor of the drive alone, since they have no class
        self.dense = replace(depths, scale=RigScale(drive.log_factor))
        corrected = drive.corrected(raw, tracks.class_id)
        return Measured(corrected, by_network=NetworkDistances(raw, errors, tracks.class_id))

    def _by_others(
        self,
        tracks: Tracks,
        values: FloatArray,
        sigmas: FloatArray,
        others: Mapping[str, Ranges],
        time_s: float,
    ) -> Ranges:
        """Distances by values (N,) that the distances of other methods calibrate: they are not
        fused where these measured.
        """
        known_m, known_sigma_m = np.full((2, len(tracks)), np.nan)
        for name in _REFERENCES:
            if (other := others.get(name)) is not None:
                known_m = np.where(np.isfinite(known_m), known_m, other.distance_m)
                known_sigma_m = np.where(np.isfinite(known_sigma_m), known_sigma_m, other.sigma_m)
        self._relative.update(values, known_m, known_sigma_m, time_s)
        return Ranges(tracks.track_id, *self._relative.distances(values, sigmas))

    @property
    def notes(self) -> tuple[str, ...]:
        """What a relative network is used for."""
        if not self._relative.is_used:
            return ()
        sentence = (
            f"The depth network {self._name} is right up to scale and shift: its distances are "
            "calibrated by those of other methods, and fused only where these have none."
        )
        return (Note(sentence, "depth-network-relative", "ok", "methods"),)


def _raw(tracks: Tracks, depths: DenseMap, values: FloatArray, sigmas: FloatArray) -> Ranges:
    """The distances of the network, with the errors of their surfaces alone."""
    if depths.quantity == "inverse_depth":
        with np.errstate(invalid="ignore", divide="ignore"):
            values, sigmas = 1.0 / values, sigmas / values**2
    is_measured = (values > 0) & np.isfinite(values)
    return Ranges(
        tracks.track_id,
        np.where(is_measured, values, np.nan),
        np.where(is_measured, sigmas, np.nan),
        is_fallback=False,
    )


def network_method(name: str) -> RangingMethod:
    """The method of a depth network: `depth`, or `depth-NAME` of several, which get letters and
    colours of their own when they are registered.
    """

    def create(context: MethodContext) -> Ranger | None:
        path = context.depth_models.get(name)
        if path is None:
            return None
        from track_range.ranging.networks.network import open_depth_network  # onnxruntime

        network = open_depth_network(path, context.runtime)
        return NetworkDepthRanger(name, network, context.camera)

    return RangingMethod(
        name=name,
        title="depth network" if name == _NAME else name.replace("-", " network ", 1),
        letter="D",
        colour="#b04a78",
        create=create,
        needs=frozenset({"image"}),
        reads=_REFERENCES,
        error_sources=(
            ErrorSource("drive_scale", systematic=0.25),
            ErrorSource("network", systematic=0.4),
            ErrorSource("own", independent=0.35),
        ),
        fallback_for="mono",
        is_optional=True,
    )


DEPTH = network_method(_NAME)


class OwnDistances(NetworkDepthRanger):
    """Ranges each box by the network's own distances, without a correction: for the measurement of
    its errors.
    """

    def measure_at_scale(
        self, tracks: Tracks, frame: Frame, others: Mapping[str, Ranges], scale: DriveScale
    ) -> Measured:
        """The network's distances, with the sigmas of their surfaces."""
        measured = super().measure_at_scale(tracks, frame, others, scale)
        if measured.by_network is None:
            raise MethodError(
                f"{self._source.path}: expected a network whose depths are right up to a factor, found "
                "one with a scale and a shift, whose errors are those of the methods that calibrate it."
            )
        return Measured(measured.by_network.ranges)
