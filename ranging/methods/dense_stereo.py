"""DenseRanger: stereo distance from the dense disparity image of semi-global matching (SGBM)."""

from track_range.foundation.arrays import FloatArray
from track_range.ranging.measurement.dense_map import DenseMap
from track_range.ranging.measurement.dense_surfaces import box_surfaces
from track_range.ranging.methods.dense_ranger import DisparityMapRanger
from track_range.ranging.methods.method import ErrorSource, MethodContext, Ranger, RangingMethod
from track_range.stereo.geometry.alignment import Alignment
from track_range.stereo.geometry.frames import Frame, whole_image
from track_range.stereo.geometry.rig import StereoRig
from track_range.stereo.matching.sgbm import Sgbm, SgbmSettings


class DenseRanger(DisparityMapRanger):
    """Ranges each box by the disparities of semi-global matching."""

    def __init__(
        self,
        rig: StereoRig,
        settings: SgbmSettings | None = None,
        *,
        alignment: Alignment | None = None,
    ) -> None:
        """Create a ranger for a rectified rig; see `DisparityMapRanger`."""
        super().__init__("sgbm", rig, alignment=alignment)
        self._settings = settings or SgbmSettings.for_rig(rig)
        self._sgbm = Sgbm(self._settings)

    def map_of(self, frame: Frame) -> DenseMap | None:
        """The disparities of a frame; None without a right image."""
        if frame.right is None:
            return None
        disparity = self._sgbm.dense_disparity(frame.left, whole_image(frame.right))
        return DenseMap(disparity, "disparity", (disparity.shape[0], disparity.shape[1]))

    def surfaces(self, dense: DenseMap, xyxy_px: FloatArray) -> tuple[FloatArray, FloatArray]:
        """See `DisparityMapRanger`; with the parameters that the user set."""
        settings = self._settings
        return box_surfaces(
            dense,
            xyxy_px,
            min_known=settings.min_valid_share,
            scatter_fraction=settings.shape_share,
        )


def _create(context: MethodContext) -> Ranger | None:
    if context.rig is None:
        return None
    settings = SgbmSettings.for_rig(context.rig, chosen=context.sgbm_options)
    return DenseRanger(context.rig, settings)


SGBM = RangingMethod(
    name="sgbm",
    title="dense stereo",
    letter="G",
    colour="#7f8a95",
    create=_create,
    needs=frozenset({"rig", "right_image", "dense_disparity"}),
    error_sources=(ErrorSource("baseline", systematic=0.91), ErrorSource("own", independent=0.09)),
    fallback_for="stereo",
)
