"""NetworkMatcher: a stereo network as a matcher of boxes, for its comparison with other ones."""

from pathlib import Path

import numpy as np

from track_range.detection.models.onnx_session import Runtime
from track_range.foundation.arrays import FloatArray, Image
from track_range.ranging.methods.network_disparity import network_surfaces
from track_range.ranging.networks.network import open_stereo_network
from track_range.stereo.geometry.frames import ImageView, whole_image
from track_range.stereo.matching.patch_matches import ExpectedDisparity, Outcome, PatchMatches


class NetworkMatcher:
    """Matcher that reads boxes in the disparities of a network; priors are not used.

    It runs on one thread, as the other matchers of an evaluation. NetworkError, ModelError: the
    file is no usable stereo network.
    """

    def __init__(self, path: Path) -> None:
        self._network = open_stereo_network(path, Runtime(n_threads=1))

    def match(
        self,
        left: Image,
        right: ImageView,
        xyxy_px: FloatArray,
        prior_px: FloatArray,
        by_size: ExpectedDisparity | None = None,
    ) -> PatchMatches:
        """See `BoxMatcher.match`; the outcome of boxes without a surface is NO_TEXTURE."""
        dense = self._network.measure(left, whole_image(right))
        disparity_px, sigma_px = network_surfaces(dense, xyxy_px)
        outcome = np.where(np.isnan(disparity_px), int(Outcome.NO_TEXTURE), int(Outcome.MATCHED))
        return PatchMatches.of(disparity_px, sigma_px, outcome)
