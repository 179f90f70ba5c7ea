"""The second pass in the band around the horizon: what it adds, where it looks, and when."""

import numpy as np
import pytest

from tests.support.networks.onnx_models import write_model
from track_range.detection.boxes import iou
from track_range.detection.catalogue.lookup import DEFAULT_MODEL, find_model
from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.detections import Detections
from track_range.detection.models.onnx_session import Runtime
from track_range.detection.yolo.detector import YoloDetector, YoloSettings
from track_range.detection.yolo.far_pass import FarPass, merged
from track_range.simulation.render.renderer import Renderer, kitti_like_rig
from track_range.simulation.world.scenarios import make_scenario
from track_range.simulation.world.truth import label_scene

PERSON, CAR, TRUCK = (ROAD_CLASSES.index(name) for name in ("person", "car", "truck"))
NONE = Detections.empty()


@pytest.fixture(scope="module")
def network():
    return YoloDetector(find_model(DEFAULT_MODEL).path, runtime=Runtime(n_threads=1))


def passes(network, every, image_hw=(36, 64), *, n_frames=7, step_s=0.1):
    """Whether road users of all sizes were sought in each of some empty frames."""
    far_pass, image = FarPass(network, every), np.zeros((*image_hw, 3), np.uint8)
    network.detect(image)
    frames = [far_pass.completed(NONE, image, step_s * k) for k in range(n_frames)]
    return [frame.is_complete for frame in frames], far_pass


def test_of_two_boxes_of_one_object_that_of_the_band_remains():
    near = Detections.of(
        [[100, 100, 140, 130], [300, 100, 420, 200], [500, 100, 520, 140]],
        [0.3, 0.9, 0.8],
        [CAR, CAR, PERSON],
    )
    far = Detections.of(
        [[102, 101, 140, 131], [500, 100, 520, 140], [600, 100, 610, 120]],
        [0.1, 0.4, 0.5],
        [TRUCK, CAR, PERSON],
    )
    both = merged(near, far)
    # a car that only the whole image shows, a person and a car at one place, a person that only the
    # band shows, and a car with the better score of both
    assert both.xyxy_px.tolist() == [
        [300, 100, 420, 200],
        [500, 100, 520, 140],
        [600, 100, 610, 120],
        [500, 100, 520, 140],
        [102, 101, 140, 131],
    ]
    assert both.score.tolist() == [0.9, 0.8, 0.5, 0.4, 0.3]
    assert both.class_id.tolist() == [CAR, PERSON, PERSON, CAR, TRUCK]


def test_boxes_that_only_the_band_shows_need_a_higher_score():
    far = Detections.of([[0, 0, 10, 10], [20, 0, 30, 10]], [0.16, 0.14], [CAR, CAR])
    assert merged(NONE, far).score.tolist() == [0.16]
    near = Detections.of([[20, 0, 30, 10]], [0.1], [CAR])
    assert merged(near, far).score.tolist() == [0.16, 0.14]


@pytest.mark.parametrize(
    ("right_px", "score", "class_id", "n"),
    [(148, 0.5, CAR, 1), (156, 0.5, CAR, 2), (148, 0.7, CAR, 2), (148, 0.5, PERSON, 2)],
)
def test_parts_of_a_better_box_are_not_added(right_px, score, class_id, n):
    """A box of 40 px inside a car up to its right edge at 150 px, or 15 % of it beyond."""
    near = Detections.of([[50, 100, 150, 180]], [0.6], [CAR])
    far = Detections.of([[right_px - 40, 120, right_px, 150]], [score], [class_id])
    assert len(merged(near, far)) == n


def test_boxes_of_one_image_do_not_suppress_each_other():
    boxes = Detections.of([[0, 0, 10, 10], [0, 0, 10, 11]], [0.9, 0.8], [CAR, CAR])
    assert len(merged(boxes, NONE)) == len(merged(NONE, boxes)) == 2


@pytest.mark.parametrize(
    ("every", "is_complete"),
    [(1, [True] * 7), (3, [True, False, False, True, False, False, True])],
)
def test_every_n_th_frame_has_a_pass(network, every, is_complete):
    completed, far_pass = passes(network, every)
    assert completed == is_complete
    assert f"in {sum(is_complete)} of 7 frames" in far_pass.notes[0]


def test_frames_without_a_pass_are_complete_where_passes_are_off(network):
    completed, far_pass = passes(network, 0)
    assert all(completed)
    assert not far_pass.n_passes
    assert not far_pass.notes


def test_passes_by_themselves_come_ten_times_per_second_in_large_images(network):
    # 1920x1080 px: 0.3 of the resolution in the whole image, 0.75 in the band
    completed, far_pass = passes(network, None, (1080, 1920), step_s=1 / 30)
    assert completed == [True, False, False, True, False, False, True]
    # 608x320 px, and 1440x256 px in three of seven frames
    assert "1440x256" in far_pass.notes[0]
    assert "1.8 times" in far_pass.notes[0]
    # a network that sees the whole image at 0.9 of its resolution
    assert passes(network, None, (360, 640))[1].n_passes == 0


def test_passes_go_on_after_frames_that_were_read_before(network):
    far_pass, image = FarPass(network), np.zeros((720, 1280, 3), np.uint8)
    network.detect(image)
    times_s = (60.0, 0.0, 0.05, 0.1)
    frames = [far_pass.completed(NONE, image, time_s) for time_s in times_s]
    assert [frame.is_complete for frame in frames] == [True, True, False, True]


def test_input_of_fixed_size_has_no_parts(tmp_path):
    rows = np.zeros((1, 3 * (8 * 8 + 4 * 4 + 2 * 2), 85))
    network = YoloDetector(write_model(tmp_path / "m.onnx", rows))
    for every, option in ((2, "--far-pass"), (None, "--size auto")):
        completed, far_pass = passes(network, every)
        assert all(completed)
        expected = f"{option} is not used: m.onnx has no colour input of variable size."
        assert far_pass.notes == (expected,)
    assert passes(network, 0)[1].notes == ()
    assert not [note for note in network.notes if "--size" in note]
    sized = YoloDetector(tmp_path / "m.onnx", YoloSettings(size_px=960))
    assert "--size is not used: the input of m.onnx has a fixed size." in sized.notes


def test_width_and_height_of_the_input():
    settings = YoloSettings(size_px=(960, 544))
    network = YoloDetector(find_model(DEFAULT_MODEL).path, settings)
    network.detect(np.zeros((720, 1280, 3), np.uint8))
    assert network.input_hw == (544, 960)


@pytest.mark.slow
@pytest.mark.parametrize("shift_px", [0, 250])
def test_people_far_away_are_found_at_their_places(network, far_people, shift_px):
    """Also where the horizon is far from the middle of the image."""
    n_people, n_near, n_both = 0, 0, 0
    far_pass = FarPass(network, 1)
    for image, people_px in far_people:
        shifted = np.roll(image, shift_px, axis=0)
        shifted_px = people_px + np.array([0, shift_px, 0, shift_px])
        near = network.detect(shifted)
        both = far_pass.completed(near, shifted, 0.0)
        n_people += len(people_px)
        n_near += found(shifted_px, near)
        n_both += found(shifted_px, both)
    assert n_people >= 15
    assert n_both >= 0.75 * n_people
    assert n_near <= 0.6 * n_both


@pytest.mark.slow
def test_high_boxes_are_those_of_the_whole_image(network, far_people):
    n_high, far_pass = 0, FarPass(network, 1)
    for image, _ in far_people:
        near = network.detect(image)
        both = far_pass.completed(near, image, 0.0)
        # 64 px of the input, 1440 px wide, in an image of 1920 px
        high = [low_px - top_px >= 64 / 0.75 for _, top_px, _, low_px in both.xyxy_px]
        is_near = (both.xyxy_px[high][:, None] == near.xyxy_px).all(axis=2)
        assert is_near.any(axis=1).all()
        n_high += sum(high)
    assert n_high >= 10


@pytest.fixture(scope="module")
def far_people():
    """Images of 1920x1080 px with the (N, 4) boxes of people at 40 to 80 m, at least half
    visible."""
    rig, times_s = kitti_like_rig(width_px=1920, height_px=1080), np.arange(0.0, 3.0, 0.5)
    images = []
    for seed in (9102, 9103, 9104):
        scene = make_scenario("crossing-adult", seed=seed, seconds=3.0)
        renderer, labels = Renderer(scene, rig), label_scene(scene, times_s, camera=rig.left)
        is_far = (labels.kitti_type == "Pedestrian") & (labels.occluded <= 1)
        is_far &= np.abs(labels.location_m[:, 2] - 60) < 20
        images += [
            (renderer.render(time_s), labels.xyxy_px[is_far & (labels.frame == frame)])
            for frame, time_s in enumerate(times_s)
        ]
    return images


def found(people_px, detections):
    people = detections.select(detections.class_id == PERSON)
    return int((iou(people_px, people.xyxy_px) >= 0.5).any(axis=1).sum())
