"""NetworkDisparityRanger: stereo distance from the dense disparities of a network of the user.

A network's disparities have the rig's scale and its alignment, as those of any matcher, and are
wrong for two further reasons: what the pixels of a box show (`box_surfaces`), and errors that all
pixels of an object share, since a network knows the shapes that it was trained on:

    sigma_network = hypot(0.3 px of the map, 1 % of the disparity)

as PSMNet (trained on KITTI 2015) shows on simulated pairs, seeds 0 to 6: 65 and 100 % of 49 boxes
are within one and two sigma. Disparities that are too large or too small by a factor, as those of a
wrong MODEL.yaml, are found by the distances of other methods (`measure_with`).
"""

import math
from collections import deque
from collections.abc import Mapping
from typing import Protocol

import numpy as np

from track_range.foundation.arrays import FloatArray, Image
from track_range.foundation.errors import Note
from track_range.ranging.measurement.dense_map import DenseMap
from track_range.ranging.measurement.dense_surfaces import box_surfaces
from track_range.ranging.measurement.ranges import Ranges
from track_range.ranging.methods.dense_ranger import DisparityMapRanger
from track_range.ranging.methods.method import ErrorSource, MethodContext, Ranger, RangingMethod
from track_range.stereo.geometry.alignment import Alignment
from track_range.stereo.geometry.frames import Frame, whole_image
from track_range.stereo.geometry.rig import StereoRig
from track_range.tracking.tracks import Tracks

_NAME = "disparity"
# standard deviation of an error that the pixels of an object share, px of the map and fraction of
# the disparity
_NETWORK_PX, _NETWORK_FRACTION = 0.3, 0.01
# methods whose distances show a wrong scale, the factor from which one is wrong, that no usual
# error
# of these reaches, and numbers of the last boxes that are compared
_WRONG_FACTOR: Mapping[str, float] = {"stereo": 1.25, "mono": 1.5}
_MIN_COMPARED, _MAX_COMPARED = 20, 300


class DisparitySource(Protocol):
    """An open stereo network, or what measures like one."""

    def measure(self, left: Image, right: Image) -> DenseMap:
        """The disparities of a rectified pair of images, (H, W, 3) in BGR or (H, W) grey."""


class NetworkDisparityRanger(DisparityMapRanger):
    """Ranges each box by the disparities of a network."""

    def __init__(
        self,
        name: str,
        network: DisparitySource,
        rig: StereoRig,
        *,
        alignment: Alignment | None = None,
    ) -> None:
        """Create a ranger of the method `name` for a rectified rig; see `DisparityMapRanger`."""
        super().__init__(name, rig, alignment=alignment)
        self._name, self._source = name, network
        # logarithms of ratios to the distances of other methods, of the last boxes
        self._ratios = {other: deque[float](maxlen=_MAX_COMPARED) for other in _WRONG_FACTOR}

    def map_of(self, frame: Frame) -> DenseMap | None:
        """The disparities of a frame; None without a right image."""
        if frame.right is None:
            return None
        return self._source.measure(frame.left, whole_image(frame.right))

    def measure_with(self, tracks: Tracks, frame: Frame, others: Mapping[str, Ranges]) -> Ranges:
        """Distances as `measure` gives them; if they are a clear factor away from those of other
        methods, the sigmas contain it.
        """
        ranges = self.measure(tracks, frame)
        for name, seen in self._ratios.items():
            if name in others:
                ratios = np.log(ranges.distance_m / others[name].distance_m)
                seen.extend(ratios[np.isfinite(ratios)].tolist())
        factor = self._wrong_factor()[0]
        return ranges if factor == 1.0 else ranges.widened(abs(1 - 1 / factor))

    def _wrong_factor(self) -> tuple[float, str]:
        """The factor of these distances to those of a method, and its name; 1 = no clear one."""
        for name, seen in self._ratios.items():
            if len(seen) >= _MIN_COMPARED:
                log_factor = float(np.median(seen))
                is_wrong = abs(log_factor) > math.log(_WRONG_FACTOR[name])
                return (math.exp(log_factor) if is_wrong else 1.0), name
        return 1.0, ""

    @property
    def notes(self) -> tuple[str, ...]:
        """A sentence about distances that are a factor away from those of another method."""
        factor, name = self._wrong_factor()
        if factor == 1.0:
            return ()
        sentence = (
            f"The distances of the stereo network {self._name} are {factor:.2f} times those of the "
            f"method {name}: wide sigmas; check scale, fit and size in its MODEL.yaml, and the rig."
        )
        return (Note(sentence, "stereo-network-scale", "warning", "methods"),)

    def surfaces(self, dense: DenseMap, xyxy_px: FloatArray) -> tuple[FloatArray, FloatArray]:
        """See `DisparityMapRanger`; with the errors that the pixels of an object share."""
        return network_surfaces(dense, xyxy_px)


def network_surfaces(dense: DenseMap, xyxy_px: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Disparities of boxes (N, 4) in the map of a network, and their standard deviations with the
    errors that the pixels of an object share, without that of the alignment, (N,) px each.
    """
    disparity_px, sigma_px = box_surfaces(dense, xyxy_px)
    map_px = dense.image_hw[1] / dense.values.shape[1]
    shared_px = np.hypot(_NETWORK_PX * map_px, _NETWORK_FRACTION * disparity_px)
    return disparity_px, np.hypot(sigma_px, shared_px)


def network_method(name: str) -> RangingMethod:
    """The method of a stereo network: `disparity`, or `disparity-NAME` of further ones."""

    def create(context: MethodContext) -> Ranger | None:
        path = context.stereo_models.get(name)
        if path is None or context.rig is None:
            return None
        from track_range.ranging.networks.network import open_stereo_network  # onnxruntime

        network = open_stereo_network(path, context.runtime)
        ranger = NetworkDisparityRanger(name, network, context.rig)
        ranger.network = network
        return ranger

    return RangingMethod(
        name=name,
        title="stereo network" if name == _NAME else f"stereo network {name.partition('-')[2]}",
        letter="N",  # further networks get another one
        colour="#5c8f2f",
        create=create,
        needs=frozenset({"image", "rig", "right_image"}),
        reads=tuple(_WRONG_FACTOR),
        error_sources=(
            ErrorSource("baseline", systematic=0.91),
            ErrorSource("own", independent=0.09),
        ),
        # The images, the rig and its alignment are those of `stereo`. Without any error of the
        # alignment, which both share, the errors of PSMNet and the patch matcher correlate by 0.56
        # (52 simulated boxes), and are 1.9 and 0.55 %: together they are no better than `stereo`.
        fallback_for="stereo",
        is_optional=True,
    )


DISPARITY = network_method(_NAME)
