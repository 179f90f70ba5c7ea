"""Pseudo-labels of an ensemble: fused boxes by hand, calibration of simulated scores, selection,
stored boxes."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
import yaml
from scipy.special import expit, logit

from tests.detection.training.road_scenes import write_data_set
from tests.support.networks.onnx_models import write_rectangle_finder
from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.detections import Detections
from track_range.detection.formats.image_labels.image_truth import ImageTruth
from track_range.detection.formats.image_labels.labelled_images import ImageFileError
from track_range.detection.formats.image_labels.yolo_labels import YoloLabelReader, YoloLabels
from track_range.detection.formats.tables.errors import LabelFileError
from track_range.detection.training.data_yaml import read_data_yaml, read_own_labels
from track_range.detection.training.ensemble.calibration import (
    EnsembleCalibration,
    Samples,
    fit_calibration,
    matches,
    reliability,
    samples,
)
from track_range.detection.training.ensemble.data_set import PseudoLabels, pseudo_labels
from track_range.detection.training.ensemble.fusion import FusedBoxes, fuse
from track_range.detection.training.ensemble.views import (
    EnsembleMember,
    ViewBoxes,
    detect_views,
    store_missing,
)
from track_range.detection.training.errors import TrainingError

PERSON, BICYCLE, CAR, MOTORCYCLE, BUS, TRUCK = range(6)
ALL: np.ndarray = np.ones(8, np.bool_)


def view_boxes(*rows):
    """Boxes of one detector from rows (x1, y1, x2, y2, score, class_id)."""
    table = np.array(rows, np.float64).reshape(-1, 6)
    return ViewBoxes(table[:, :4], table[:, 4], table[:, 5].astype(np.int64))


def detections_of(*rows):
    boxes = view_boxes(*rows)
    return YoloLabels(boxes.xyxy, boxes.class_id, boxes.score, ())


def truth_of(*rows, incomplete=()):
    """Labels (x1, y1, x2, y2, class_id) of an image in which some classes are not completely
    labelled."""
    table = np.array(rows, np.float64).reshape(-1, 5)
    return replace(
        ImageTruth.of(table[:, :4], table[:, 4]), is_complete=~np.isin(np.arange(8), incomplete)
    )


def scores(n_detectors, *entries):
    """(K, D, 8) scores from {(detector, class_id): score} of each box."""
    score = np.zeros((len(entries), n_detectors, 8))
    for k, entry in enumerate(entries):
        for index, value in entry.items():
            score[k][index] = value
    return score


def probabilities(*entries):
    """(K, 8) probabilities from {class_id: probability} of each box."""
    return scores(1, *({(0, class_id): p for class_id, p in entry.items()} for entry in entries))[
        :, 0
    ]


def test_views_are_in_the_coordinates_of_the_image():
    class Marked:
        """Detector of a fixed box, and of one that is too narrow."""

        def __init__(self):
            self.images = []

        def detect(self, image):
            self.images.append(image)
            return Detections.of(
                [[9.5, 19.5, 29.5, 39.5], [50, 0, 51, 40]], [0.8, 0.9], [CAR, PERSON]
            )

    detector, image = Marked(), np.zeros((40, 100, 3), np.uint8)
    image[:, 0] = 255
    boxes = detect_views(detector, image)
    assert detector.images[1][0, -1, 0] == 255
    np.testing.assert_allclose(boxes.xyxy, [[0.1, 0.5, 0.3, 1.0], [0.7, 0.5, 0.9, 1.0]])
    assert (boxes.score.tolist(), boxes.class_id.tolist()) == ([0.8, 0.8], [CAR, CAR])


def test_fusion_by_hand():
    # two detectors, with the boxes of both views; truck and car are confused on one object
    first = view_boxes(
        (0.1, 0.1, 0.3, 0.3, 0.8, CAR),
        (0.1, 0.1, 0.32, 0.3, 0.4, CAR),
        (0.7, 0.7, 0.8, 0.9, 0.03, CAR),
    )
    second = view_boxes((0.1, 0.1, 0.3, 0.34, 0.6, TRUCK), (0.1, 0.1, 0.3, 0.3, 0.5, PERSON))
    fused = fuse([first, second])
    weight = np.array([0.64, 0.16, 0.36])
    x2, y2 = weight @ [0.3, 0.32, 0.3] / weight.sum(), weight @ [0.3, 0.3, 0.34] / weight.sum()
    np.testing.assert_allclose(fused.xyxy, [[0.1, 0.1, x2, y2], [0.1, 0.1, 0.3, 0.3]])
    expected = scores(2, {(0, CAR): 0.6, (1, TRUCK): 0.3}, {(1, PERSON): 0.25})
    np.testing.assert_allclose(fused.score, expected)  # the box with 0.03 does not start a cluster


def test_fusion_does_not_depend_on_the_order_of_the_boxes():
    rng = np.random.default_rng(4)
    corner, size = rng.uniform(0, 0.8, (60, 2)), rng.uniform(0.05, 0.2, (60, 2))
    table = np.column_stack(
        [corner, corner + size, rng.uniform(0.02, 1, 60), rng.integers(0, 8, 60)]
    )
    fused, mixed = fuse([view_boxes(*table)]), fuse([view_boxes(*rng.permutation(table))])
    np.testing.assert_allclose(mixed.xyxy, fused.xyxy)
    np.testing.assert_allclose(mixed.score, fused.score)
    assert fused.score.sum() <= table[:, 4].sum() / 2 + 1e-9


def test_fusion_without_boxes():
    fused = fuse([view_boxes(), view_boxes()])
    assert (fused.xyxy.shape, fused.score.shape) == ((0, 4), (0, 2, 8))
    assert not matches(fused, truth_of((0, 0, 1, 1, CAR)), CAR).any()


def test_a_label_is_matched_once_and_by_the_best_box():
    boxes = [
        [0.0, 0.0, 0.2, 0.2],
        [0.01, 0.0, 0.21, 0.2],
        [0.5, 0.5, 0.7, 0.7],
        [0.5, 0.5, 0.6, 0.6],
    ]
    score = scores(1, {(0, CAR): 0.4}, {(0, CAR): 0.9}, {(0, CAR): 0.3}, {(0, CAR): 0.8})
    truth = truth_of(
        (0.0, 0.0, 0.2, 0.2, CAR), (0.5, 0.5, 0.7, 0.7, CAR), (0.5, 0.5, 0.6, 0.6, PERSON)
    )
    assert matches(FusedBoxes(np.array(boxes), score), truth, CAR).tolist() == [
        False,
        True,
        True,
        False,
    ]


def simulated(rng, n, *, weight, intercept):
    """Samples whose matches have the probability sigma(a + w logit(s))."""
    score = rng.uniform(0.02, 0.98, (n, len(weight)))
    probability = expit(intercept + logit(score) @ weight)
    return Samples(score, rng.random(n) < probability), probability


def test_calibration_recovers_the_probabilities_of_simulated_scores():
    rng = np.random.default_rng(0)
    by_class = [Samples(np.zeros((0, 2)), np.zeros(0, np.bool_))] * 8
    cars, _ = simulated(rng, 20_000, weight=[0.9, 0.5], intercept=-0.7)
    buses, _ = simulated(rng, 20_000, weight=[0.0, 1.3], intercept=0.4)
    by_class[CAR], by_class[BUS] = cars, buses
    is_known = np.ones((2, 8), np.bool_)
    is_known[0, [BUS, TRUCK]] = False
    calibration = fit_calibration(by_class, is_known)
    np.testing.assert_allclose(calibration.weight[CAR], [0.9, 0.5], atol=0.05)
    np.testing.assert_allclose(calibration.weight[BUS], [0.0, 1.3], atol=0.05)
    np.testing.assert_allclose(calibration.intercept[[CAR, BUS]], [-0.7, 0.4], atol=0.05)
    assert calibration.weight[BUS, 0] == 0
    assert calibration.n_positives.tolist()[CAR] == np.count_nonzero(cars.is_match)
    # classes without matches have the mean; that of a detector that does not know the class goes to
    # the other
    mean = calibration.weight[[CAR, BUS]].mean(axis=0)
    np.testing.assert_allclose(calibration.weight[PERSON], mean)
    np.testing.assert_allclose(calibration.weight[TRUCK], [0, mean.sum()])
    other, probability = simulated(rng, 5_000, weight=[0.9, 0.5], intercept=-0.7)
    score = np.zeros((5_000, 2, 8))
    score[:, :, CAR] = other.score
    np.testing.assert_allclose(calibration.probability(score)[:, CAR], probability, atol=0.02)
    assert not calibration.probability(score)[:, PERSON].any()  # not detected
    verified = reliability(calibration, other, CAR)
    assert verified.n.sum() == 5_000
    np.testing.assert_allclose(verified.mean_score, verified.precision, atol=0.05)


def test_weights_are_not_negative():
    rng = np.random.default_rng(1)
    by_class = [simulated(rng, 2_000, weight=[1.0, -0.5], intercept=0.0)[0]] * 8
    calibration = fit_calibration(by_class, np.ones((2, 8), np.bool_))
    assert (calibration.weight >= 0).all()
    assert calibration.weight[CAR, 1] == 0


def test_too_few_matches_for_a_calibration():
    score, is_match = np.full((100, 1), 0.5), np.arange(100) < 19
    assert fit_calibration([Samples(score, is_match)] * 8, np.ones((1, 8), np.bool_)) is None


def test_samples_are_from_completely_labelled_images():
    boxes, box = np.array([[0.0, 0.0, 0.2, 0.2]]), (0.0, 0.0, 0.2, 0.2)
    fused = FusedBoxes(boxes, scores(1, {(0, CAR): 0.4, (0, PERSON): 0.02}))
    images = [
        (fused, truth_of((*box, CAR))),
        (fused, truth_of()),
        (fused, truth_of((*box, CAR), incomplete=[CAR])),
    ]
    by_class = samples(images, n_detectors=1, is_labelled=ALL)
    assert by_class[CAR].is_match.tolist() == [True, False]
    assert by_class[CAR].score.tolist() == [[0.4], [0.4]]
    assert not len(by_class[PERSON].score)  # the lowest score of the detectors
    assert not len(samples(images, n_detectors=1, is_labelled=~ALL)[CAR].score)


BOXES = np.array(
    [[0.0, 0.0, 0.2, 0.2], [0.4, 0.4, 0.6, 0.6], [0.7, 0.7, 0.9, 0.9], [-0.1, 0.5, 0.2, 0.8]]
)


def test_selection_by_probability_and_labels():
    p = probabilities(
        {CAR: 0.9}, {CAR: 0.3, TRUCK: 0.2}, {PERSON: 0.59, BUS: 0.7}, {CAR: 0.05, MOTORCYCLE: 0.5}
    )
    truth = truth_of((0.0, 0.0, 0.19, 0.2, PERSON), incomplete=[CAR, TRUCK, MOTORCYCLE])
    is_known = ALL.copy()
    is_known[TRUCK] = False
    labels = pseudo_labels(BOXES, p, truth, is_known=is_known)
    # the first box is that of a label, the truck is not known, persons are labelled completely
    assert labels.class_id.tolist() == [CAR, BUS, MOTORCYCLE]
    assert labels.probability.tolist() == [0.3, 0.7, 0.5]
    assert labels.is_ignored.tolist() == [False, True, False]
    assert labels.xyxy[2].tolist() == [0.0, 0.5, 0.2, 0.8]
    more = pseudo_labels(BOXES, p, truth, is_known=is_known, min_probability=0.05)
    assert more.class_id.tolist() == [CAR, BUS, CAR, MOTORCYCLE]


def test_combination_with_another_detector_by_hand():
    p = probabilities({CAR: 0.9}, {CAR: 0.9}, {CAR: 0.02}, {PERSON: 0.7})
    other = detections_of(
        (0.0, 0.0, 0.2, 0.2, 0.5, CAR),
        (0.7, 0.7, 0.9, 0.9, 0.5, CAR),  # nearly invisible to the ensemble
        (0.4, 0.0, 0.6, 0.2, 0.4, CAR),  # only in the other detector
        (0.4, 0.7, 0.6, 0.9, 0.4, 7),  # of a class that the ensemble does not know
        (0.0, 0.8, 0.2, 1.0, 0.9, PERSON),  # of a completely labelled class
        (0.7, 0.0, 0.9, 0.2, 0.12, CAR),  # 0.09 < 0.1
    )
    is_known = ALL.copy()
    is_known[7] = False
    truth = truth_of(incomplete=[CAR, 7])
    labels = pseudo_labels(BOXES, p, truth, is_known=is_known, other=other)
    # sqrt of the products of odds
    both, alone = 1 / (1 + 9**-0.5), 1 / (1 + (9 * 0.12 / 0.88) ** -0.5)
    assert labels.class_id.tolist() == [CAR, CAR, CAR, PERSON, CAR, 7]
    np.testing.assert_allclose(labels.probability, [both, alone, 0.6 * 0.5, 0.7, 0.75 * 0.4, 0.4])
    without = pseudo_labels(BOXES, p, truth, is_known=is_known)
    assert without.probability.tolist() == [0.9, 0.9, 0.7]  # that of the person is ignored


def test_no_boxes_and_no_detections():
    empty = pseudo_labels(
        np.zeros((0, 4)), np.zeros((0, 8)), truth_of(), is_known=ALL, other=detections_of()
    )
    assert empty.as_text(ROAD_CLASSES) == ""
    alone = detections_of((0.4, 0.0, 0.6, 0.2, 0.4, CAR))
    labels = pseudo_labels(
        np.zeros((0, 4)), np.zeros((0, 8)), truth_of(incomplete=[CAR]), is_known=ALL, other=alone
    )
    np.testing.assert_allclose(labels.probability, [0.3])


def test_label_files_have_the_class_numbers_of_the_data_set(tmp_path):
    labels = PseudoLabels(
        np.array([[0.1, 0.2, 0.3, 0.6], [0.5, 0.5, 0.7, 0.9], [0.0, 0.0, 0.1, 0.1]]),
        np.array([CAR, PERSON, BUS]),
        np.array([0.25, 1.0, 0.9]),
        np.zeros(3, np.bool_),
    )
    file = tmp_path / "a.txt"
    file.write_text(labels.as_text(["zebra", "person", "van", "car"]))  # no bus
    # vans are cars
    assert file.read_text().splitlines()[0] == "2 0.200000 0.400000 0.200000 0.400000 0.250"
    read = YoloLabelReader(["zebra", "person", "van", "car"]).read(file)
    assert (read.class_id.tolist(), read.score.tolist()) == ([CAR, PERSON], [0.25, 1.0])
    np.testing.assert_allclose(read.xyxy, labels.xyxy[:2])


def test_stored_boxes(tmp_path):
    model = write_rectangle_finder(
        tmp_path / "cars.onnx", side_px=64, grey=114 / 255, metadata={"names": "['car']"}
    )
    image = np.full((64, 64, 3), 114, np.uint8)
    image[20:40, 8:32] = 255
    file, stored = tmp_path / "a.png", tmp_path / "stored"
    member = EnsembleMember(model, stored)
    assert np.flatnonzero(member.is_known).tolist() == [CAR]
    assert not member.has_boxes(file)
    member.store_boxes(file, image)
    np.testing.assert_allclose(
        member.boxes(file).xyxy, [np.array([8, 20, 32, 40]) / 64] * 2, atol=1e-6
    )
    assert EnsembleMember(model, stored).has_boxes(file)
    assert not EnsembleMember(model, stored, size_px=128).has_boxes(file)
    assert not member.has_boxes(tmp_path / "other" / "a.png")
    (npy,) = stored.rglob("*.npy")
    for content in (np.zeros((3, 5)), np.full((1, 6), np.nan), np.full((1, 6), 9.0)):
        np.save(npy, content)
        with pytest.raises(TrainingError, match=r"a-.*\.npy: expected the boxes"):
            member.boxes(file)
    npy.write_bytes(b"no array")
    with pytest.raises(TrainingError, match=r"a-.*\.npy"):
        member.boxes(file)
    cv2.imwrite(str(file), image)
    assert not member.has_boxes(file)  # the image was replaced
    for name in ("b.png", "c.png"):
        (tmp_path / name).write_bytes(b"no image")
    reasons = store_missing([file, tmp_path / "b.png"], [member])
    assert list(reasons) == [tmp_path / "b.png"]
    with pytest.raises(ImageFileError, match=r"none of the 2 images .*b\.png"):
        store_missing([tmp_path / "b.png", tmp_path / "c.png"], [member])


def changed(path, **changes):
    document = yaml.safe_load(path.read_text()) | changes
    path.write_text(
        yaml.safe_dump({key: value for key, value in document.items() if value is not None})
    )
    return path


def test_labels_without_pseudo_labels_and_repetitions(tmp_path):
    for name in ("own", "nested"):
        (tmp_path / name).mkdir()
    write_data_set(tmp_path / "nested", n_train=2)
    path = write_data_set(tmp_path / "own", n_train=3, n_val=1)
    (tmp_path / "own/teacher").mkdir()
    (tmp_path / "own/teacher/001.txt").write_text("0 .2 .2 .1 .1 0.45\n")
    (tmp_path / "own/rare.txt").write_text("images/train/002.png\n")
    entries = ["images/train", "rare.txt", "../nested/data.yaml"]
    changed(path, train=entries, labels_pseudo="teacher")
    assert len(read_data_yaml(path).train) == 6
    own = read_own_labels(path)
    assert [item.path.name for item in own.train] == ["000.png", "001.png", "002.png"]
    assert [len(own.labels_pseudo[item.path].score) for item in own.train] == [0, 1, 0]
    assert all((item.truth.confidence == 1).all() for item in own.train)
    assert (own.names, np.flatnonzero(own.is_named).tolist()) == (("car", "person"), [PERSON, CAR])
    assert len(own.image_files) == 4
    assert any("nested" in note for note in own.notes)
    assert read_own_labels(changed(path, labels_pseudo=None)).labels_pseudo is None
    assert read_own_labels(changed(path, val="../nested/data.yaml")).val == []


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"train": ["images/train", "images/val"]}, r"data\.yaml: .*different names.*'000'"),
        ({"format": "kitti"}, r"data\.yaml: .*kitti"),
        (
            {"labels_pseudo": "labels", "pseudo_scores": "probabilities"},
            r"data\.yaml: .*pseudo_scores",
        ),
        ({"labels_pseudo": "nowhere"}, r"data\.yaml: .*nowhere"),
        ({"names": ["zebra"]}, r"data\.yaml: names"),
    ],
)
def test_data_that_cannot_get_pseudo_labels(tmp_path, changes, message):
    path = changed(write_data_set(tmp_path, n_train=1, n_val=1), **changes)
    with pytest.raises(LabelFileError, match=message):
        read_own_labels(path)


def test_probability_of_unknown_scores_is_finite():
    calibration = EnsembleCalibration(np.zeros(8), np.ones((8, 1)), np.full(8, 20))
    score = np.linspace(0, 1, 11)[:, None, None] * np.ones((1, 1, 8))
    assert np.isfinite(calibration.probability(score)).all()
