"""Tests of the time to collision from the growth of boxes and images."""

import numpy as np
import pytest

from track_range.detection.classes import ROAD_CLASSES
from track_range.ranging.fusion.error_model import ErrorModel
from track_range.ranging.methods.expansion import EXPANSION, ExpansionRanger
from track_range.ranging.methods.method import MethodContext
from track_range.ranging.registry import methods
from track_range.ranging.size_models.size_model import BoxNoise
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.frames import Frame
from track_range.tracking.tracks import Tracks

CAMERA = PinholeCamera(700.0, 700.0, 320.0, 180.0, width_px=640, height_px=360)
BLANK = np.zeros((360, 640, 3), np.uint8)
CAR, PERSON = ROAD_CLASSES.index("car"), ROAD_CLASSES.index("person")


def times(
    *,
    start_m=40.0,
    closing_mps=8.0,
    class_id=CAR,
    size_m=(1.9, 1.6),
    noise_px=0.5,
    n=60,
    focal_px=700.0,
):
    """Times to collision, sigmas and the true time of n objects after 2 s, of boxes only."""
    camera = PinholeCamera(focal_px, focal_px, 320.0, 180.0, width_px=640, height_px=360)
    ranger, rng = (
        ExpansionRanger(camera, noise=BoxNoise(noise_px, 0.0, 0.0), has_images=False),
        np.random.default_rng(4),
    )
    for step in range(21):
        distance_m = start_m - 0.1 * closing_mps * step
        half = 350.0 * np.array(size_m) / distance_m
        boxes = (
            np.tile([320.0, 180.0], 2)
            + np.concatenate([-half, half])
            + rng.normal(0, noise_px, (n, 4))
        )
        tracks = Tracks(np.arange(n), boxes, np.full(n, class_id), np.ones(n), np.ones(n, np.bool_))
        ranges = ranger.measure(tracks, Frame(step, 0.1 * step, BLANK, None))
    assert np.isnan(ranges.distance_m).all()
    assert ranges.growth is None
    return ranges.details["ttc_s"], ranges.details["ttc_sigma_s"], distance_m / closing_mps


@pytest.mark.parametrize(("class_id", "size_m"), [(CAR, (1.9, 1.6)), (PERSON, (0.6, 1.8))])
def test_boxes_only(class_id, size_m):
    """Nearly unbiased with a true sigma, whatever the size of the object."""
    ttc_s, sigma_s, true_s = times(class_id=class_id, size_m=size_m)
    assert np.isfinite(ttc_s).mean() > 0.9
    assert np.nanmedian(ttc_s) == pytest.approx(true_s, rel=0.08)
    # the filter allows for braking
    assert 0.3 < np.sqrt(np.nanmean(((ttc_s - true_s) / sigma_s) ** 2)) < 1.2


def test_focal_length_does_not_matter():
    """Boxes of a camera with 700 px; a focal length that is 30 % wrong changes the time by a
    fraction of that."""
    right, _, true_s = times(n=200)
    wrong, _, _ = times(n=200, focal_px=910.0)
    assert np.nanmedian(wrong) == pytest.approx(np.nanmedian(right), rel=0.03)
    assert np.nanmedian(right) == pytest.approx(true_s, rel=0.08)


def test_uncertain_and_receding_objects_have_no_time():
    """A car that is 9 px high, with 2 px noise, and one that draws away."""
    far, _, _ = times(start_m=120.0, noise_px=2.0)
    assert np.isfinite(far).mean() < 0.2
    receding, _, _ = times(start_m=15.0, closing_mps=-4.0)
    assert np.isnan(receding).all()


def test_images_make_it_precise():
    """The textured square of the tests of registration, 20 px high and closing: box noise of 1 px
    hardly matters."""
    from tests.ranging.patch_scenes import SIZE_PX, scene, texture, tracks

    errors = {True: [], False: []}
    for seed in range(6):
        rangers = {
            has: ExpansionRanger(CAMERA, noise=BoxNoise(1.0, 0.0, 0.0), has_images=has)
            for has in errors
        }
        pattern = texture(seed)
        for step in range(11):
            distance_m = 40.0 - 0.8 * step
            size_px, middle = SIZE_PX * 40.0 / distance_m, np.array([[320.0 + step, 180.0]])
            image = scene([(pattern, middle[0], size_px)], seed=100 * seed + step)
            boxes = tracks(middle, size_px, noise_px=1.0, seed=100 * seed + step)
            for has_images, ranger in rangers.items():
                ttc_s = ranger.measure(boxes, Frame(step, 0.1 * step, image, None)).details["ttc_s"]
                if step == 10:
                    errors[has_images].append(abs(float(ttc_s[0]) / (distance_m / 8.0) - 1))
    assert np.isfinite(errors[True]).sum() >= 5
    assert np.nanmedian(errors[True]) < 0.1
    assert not np.nanmedian(errors[False]) < 1.2 * np.nanmedian(errors[True])


def test_it_is_no_method_of_distances():
    """Created from any context, and left out of fusion."""
    assert isinstance(
        EXPANSION.create(MethodContext(camera=CAMERA, has_images=False)), ExpansionRanger
    )
    assert "expansion" not in ErrorModel.of(methods()).names
    assert len(ErrorModel.of(methods()).names) == len(methods()) - 1
