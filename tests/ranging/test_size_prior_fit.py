"""Fit of size priors to labels: sizes by object, scatter by box, and too few labels."""

from dataclasses import replace

import numpy as np
import pytest

from tests.ranging.made_up_boxes import made_up_boxes
from track_range.ranging.evaluation.box_evaluation import figures
from track_range.ranging.evaluation.box_methods import MethodOptions, measured_by, size_fitter
from track_range.ranging.fitting.cross_validation import cross_validated
from track_range.ranging.fitting.prior_fit import STANDARD_SIZES, fit_size_priors
from track_range.ranging.methods.size_regression import MONO
from track_range.ranging.size_models.cuboid import box_of_cuboid
from track_range.ranging.size_models.curve import CurveError
from track_range.ranging.size_models.prior import YAW_DEG, ShapeTables
from track_range.ranging.truth.labelled_boxes import box_set

MEAN_M, SIGMA = np.array([1.45, 1.70, 4.30]), np.array([0.06, 0.05, 0.09])


def labelled(n_objects=120, n_each=10, *, seed=0, name="car"):
    """Cars of known sizes, mostly seen from behind, with boxes 2 % taller than the cars."""
    rng = np.random.default_rng(seed)
    n = n_objects * n_each
    object_id = np.repeat(np.arange(n_objects), n_each)
    hwl = (MEAN_M * np.exp(rng.normal(0, SIGMA, (n_objects, 3))))[object_id]
    turn = np.where(rng.random(n) < 0.7, 0.0, np.pi / 2)
    bearing, distance_m = rng.uniform(-0.3, 0.3, n), rng.uniform(8, 60, n)
    box = box_of_cuboid(
        np.log(hwl).T, yaw_rad=turn, bearing=bearing, distance_m=distance_m, camera_height_m=1.65
    )
    sizes = np.exp(
        np.stack([box.log_width, box.log_height + 0.02 + rng.normal(0, 0.03, n)], axis=1)
    )
    return made_up_boxes(
        name,
        sizes,
        bearing,
        distance_m,
        sequence=object_id % 5,
        track_id=object_id,
        size_hwl_m=hwl,
        rotation_y_rad=turn - np.pi / 2,
    )


def test_fit_recovers_sizes_yaw_offset_and_scatter():
    prior = fit_size_priors(labelled(), source="made up").priors["car"]
    np.testing.assert_allclose(prior.hwl_m, MEAN_M, rtol=0.03)
    np.testing.assert_allclose(prior.log_sigma, SIGMA, rtol=0.35)
    assert prior.offset[0] == pytest.approx(0.02, abs=0.004)
    assert prior.scatter[0] == pytest.approx(0.03, abs=0.006)
    assert prior.scatter[1] == 0.02  # exact widths: the smallest scatter
    assert prior.turn_weights[0] == pytest.approx(0.63, abs=0.06)
    assert prior.turn_weights[-1] == pytest.approx(0.27, abs=0.06)
    assert (prior.n_tracks, prior.n_boxes, prior.source) == (120, 1200, "made up")
    assert prior.faults() == ""


def test_few_objects_keep_the_spread():
    """Three cars of one size: the standard size contributes, and the spread remains."""
    labels = labelled(3, 50)
    same = replace(labels, size_hwl_m=np.tile(MEAN_M, (150, 1)))
    prior = fit_size_priors(same, source="").priors["car"]
    assert MEAN_M[0] < prior.hwl_m[0] < STANDARD_SIZES["car"][0][0]
    assert prior.log_sigma[0] > 0.02


def test_variation_between_drives():
    """Five drives whose cars differ by 8 % in height have a larger deviation of drives than equal
    ones."""
    labels = labelled()
    factor = np.exp(0.08 * np.array([-1.2, 0.7, 1.4, -0.9, 0.0]))[labels.sequence]
    different = replace(
        labels,
        size_hwl_m=labels.size_hwl_m * np.stack([factor, 1 + 0 * factor, 1 + 0 * factor], axis=1),
    )
    equal, unequal = (
        fit_size_priors(part, source="").priors["car"] for part in (labels, different)
    )
    assert 0.01 < equal.drive_sigma < 0.035
    assert 0.045 < unequal.drive_sigma < 0.1
    assert unequal.log_sigma[0] > equal.log_sigma[0]
    one = fit_size_priors(replace(labels, sequence=0 * labels.sequence), source="").priors["car"]
    assert 0.02 < one.drive_sigma <= 0.03  # the standard value has the weight of six drives


def test_class_with_few_labels_has_its_standard_size():
    priors = fit_size_priors(labelled(), source="").priors
    assert set(priors) == set(STANDARD_SIZES)
    assert priors["truck"].hwl_m == STANDARD_SIZES["truck"][0]
    assert "not fitted" in priors["truck"].source
    assert not priors["traffic sign"].stands


def test_too_few_3d_boxes_are_refused():
    labels = labelled()
    for bad in (
        replace(labels, size_hwl_m=np.full((1200, 3), np.nan)),
        labels.select(np.arange(10)),
        labels.select(labels.track_id < 2),
    ):
        with pytest.raises(CurveError, match=r"at least 100 .* 3 objects"):
            fit_size_priors(bad, source="")


def test_tables_interpolate_the_geometry():
    prior = replace(fit_size_priors(labelled(), source="").priors["car"], offset=(0.0, 0.0))
    tables = ShapeTables({"car": prior})
    rng = np.random.default_rng(1)
    bearing, log_m = rng.uniform(0, 0.6, 50), rng.uniform(np.log(8), np.log(90), 50)
    off, step, nodes = tables.at(np.zeros((50, 1), np.int64), bearing, log_m[:, None])
    (per_log_m, _), (log_height, _) = nodes.slopes_and_sizes[..., 0, :]
    seen = log_height + step * per_log_m + off[:, None] * nodes.per_bearing[0, :, 0]
    for k, turn in enumerate(np.radians(YAW_DEG)):
        box = box_of_cuboid(
            np.log(prior.hwl_m),
            yaw_rad=np.full(50, turn),
            bearing=bearing,
            distance_m=np.exp(log_m),
            camera_height_m=1.65,
        )
        np.testing.assert_allclose(seen[:, k], box.log_height, atol=0.02)
        contact = nodes.log_contact_ratio[:, 0, k]
        np.testing.assert_allclose(contact - log_m, box.log_inverse_depth, atol=0.1)


@pytest.fixture(scope="module")
def kitti(shared_data):
    place = shared_data / "kitti_labels"
    return box_set(place / "label_02", place / "calib")


@pytest.mark.parametrize("noise_px", [0.0, 2.0])
def test_cross_validated_error_on_kitti(kitti, noise_px):
    """Two-sided bounds of the errors: smaller ones would also be a bug."""
    boxes = kitti.with_noise(noise_px, seed=0) if noise_px else kitti
    plain = measured_by(("inverse-height", "log-linear", "height-5"), boxes, kitti)
    plain = {name: figures(boxes, column) for name, column in plain.items()}
    column = cross_validated(
        boxes, kitti, size_fitter(MONO, MethodOptions(box_sigma_px=noise_px, region="europe"))
    )
    mono = figures(boxes, column)
    key = "mean_relative_error_pct"
    for kind, fraction, least in (("car", 0.9, 4.0), ("person", 0.9, 3.4), ("bicycle", 0.95, 2.0)):
        best = min(rows[kind][key] for rows in plain.values())
        assert least < mono[kind][key] < fraction * best, kind
    assert mono["van"][key] < 0.75 * plain["log-linear"]["van"][key]
    assert mono["truck"][key] < 9.0
    for kind in ("car", "van", "person", "bicycle"):  # sigma holds for drives of other cities, too
        assert 0.60 < mono[kind]["within_1_sigma"] < 0.87, kind
        assert mono[kind]["within_2_sigma"] > 0.925, kind
