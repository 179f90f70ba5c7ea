"""Training end to end on drawn scenes: learning, resuming after a kill, and errors."""

import csv
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
import torch

from tests.detection.training.short_trainings import SMALL, Killed, Quiet, weights
from track_range.detection.models.onnx_session import ModelError
from track_range.detection.training.data.augmentation import AugmentationSettings
from track_range.detection.training.data.batches import BatchMaker
from track_range.detection.training.errors import CheckpointError, TrainingError
from track_range.detection.training.networks.blocks import ConvolutionBlock
from track_range.detection.training.networks.registry import make_network
from track_range.detection.training.run_folder import (
    BEST,
    LAST,
    RESULTS,
    check_same_run,
    load_checkpoint,
    load_mean,
    save_checkpoint,
)
from track_range.detection.training.schedule import (
    SGD,
    Schedule,
    ScheduleSettings,
    WeightAverage,
    optimiser_of,
)
from track_range.detection.training.settings import TrainingSettings
from track_range.detection.training.teacher import Teacher
from track_range.detection.training.train import Training, export_onnx, prepare_torch

PLAIN = AugmentationSettings(
    mosaic=0.0, min_gain=1.0, max_gain=1.0, shift=0.0, mirror=0.0, hue=0, saturation=0, value=0
)


def training(sets, out, settings=SMALL, *, name="yolov5n", teacher=None, **options):
    out.mkdir(exist_ok=True)
    prepare_torch(seed=settings.seed)
    network = make_network(name, len(sets.road_class_id), **options)
    return Training(network, settings, sets, out, teacher=teacher)


@pytest.mark.train
@pytest.mark.parametrize("name", ["yolov5n", "road"])
def test_killed_run_resumes_exactly(sets, tmp_path, name):
    straight = training(sets, tmp_path / "straight", name=name)
    straight.run(Quiet())
    killed = training(sets, tmp_path / "killed", name=name)
    with pytest.raises(KeyboardInterrupt):
        killed.run(Killed())
    assert len(load_checkpoint(tmp_path / "killed" / LAST)["history"]) == 2
    resumed = training(sets, tmp_path / "killed", name=name)
    resumed.resume()
    resumed.run(Quiet())
    assert torch.equal(weights(resumed), weights(straight))
    drop = {"minutes"}
    rows = [
        [{k: v for k, v in row.items() if k not in drop} for row in run.history]
        for run in (resumed, straight)
    ]
    assert repr(rows[0]) == repr(rows[1])


@pytest.mark.train
def test_files_of_the_run_folder(sets, tmp_path):
    run = training(sets, tmp_path, replace(SMALL, n_epochs=3))
    run.run(Quiet())
    with (tmp_path / RESULTS).open() as file:
        rows = list(csv.DictReader(file))
    assert [row["epoch"] for row in rows] == ["1", "2", "3"]
    assert [row["ap50"] != "" for row in rows] == [False, True, True]
    assert float(rows[-1]["loss_box"]) < float(rows[0]["loss_box"])
    assert (tmp_path / BEST).is_file()
    assert not list(tmp_path.glob(".*"))


@pytest.mark.train
@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda s, o: training(s, o, name="yolov4-tiny"), "--model yolov4-tiny, got .* yolov5n"),
        (lambda s, o: training(s, o, has_cbam=True), "--attention True, got .* False"),
        (lambda s, o: training(s, o, replace(SMALL, size_px=128)), "--size 128, got .* 96"),
        (
            lambda s, o: training(s, o, replace(SMALL, box_loss="eiou")),
            "--box-loss eiou, got .* ciou",
        ),
        (
            lambda s, o: training(
                s, o, replace(SMALL, augmentation=AugmentationSettings(mosaic=0.5))
            ),
            "--mosaic",
        ),
    ],
)
def test_checkpoint_of_another_run(sets, tmp_path, change, message):
    run = training(sets, tmp_path, replace(SMALL, n_epochs=1))
    run.run(Quiet())
    content = load_checkpoint(tmp_path / LAST)
    content["identity"]["n_epochs"] = SMALL.n_epochs
    torch.save(content, tmp_path / LAST)
    with pytest.raises(CheckpointError, match=rf"last\.pt: .*{message}"):
        change(sets, tmp_path).resume()


def test_no_checkpoint_and_damaged_ones(sets, tmp_path):
    run = training(sets, tmp_path)
    with pytest.raises(CheckpointError, match=r"last\.pt: no such"):
        run.resume()
    for content in (b"", b"PK\x03\x04 cut off", b"text"):
        (tmp_path / LAST).write_bytes(content)
        with pytest.raises(CheckpointError, match=r"last\.pt: .*no intact checkpoint"):
            run.resume()
    torch.save({"weights": torch.zeros(2)}, tmp_path / LAST)
    with pytest.raises(CheckpointError, match=r"last\.pt: expected a checkpoint"):
        run.resume()


def test_checkpoints_of_unusable_content(sets, tmp_path):
    run = training(sets, tmp_path)
    content = {
        "format": 1,
        "identity": run._identity(),
        "network": run.network.state_dict(),
        "average": run.average.network.state_dict(),
        "optimiser": run._optimiser.state_dict(),
        "scaler": {},
        "history": [],
    }
    torch.save(content, tmp_path / LAST)
    run.resume()
    run.start_from(tmp_path / LAST)
    for change in (
        {"identity": ["road"]},
        {"identity": run._identity() | {"classes": [0, 1]}},
        {"average": dict.fromkeys(content["average"], 3)},
        {"average": list(content["average"].values())},
        {"network": {1: torch.zeros(2)}},
        {"history": [1.0]},
        {"history": [{"ap50": "high"}]},
        {"optimiser": []},
        {"optimiser": {"state": {}, "param_groups": [1, 2, 3]}},
    ):
        torch.save(content | change, tmp_path / LAST)
        with pytest.raises(CheckpointError, match=r"last\.pt: damaged"):
            run.resume()
        if "identity" in change or "average" in change:
            with pytest.raises(CheckpointError, match=r"last\.pt: damaged"):
                run.start_from(tmp_path / LAST)
    for key in ("identity", "average"):
        torch.save({name: value for name, value in content.items() if name != key}, tmp_path / LAST)
        for use in (run.resume, lambda: run.start_from(tmp_path / LAST)):
            with pytest.raises(CheckpointError, match=r"last\.pt: "):
                use()


def test_epochs_without_mosaics():
    settings = TrainingSettings(n_epochs=5, n_last_epochs=2)
    assert [settings.augmentation_in(i).mosaic > 0 for i in range(5)] == [True] * 3 + [False] * 2
    assert TrainingSettings(n_epochs=5, n_last_epochs=5).augmentation_in(0).mosaic == 0
    with pytest.raises(TrainingError, match=r"--last-epochs: .*--epochs.* 5"):
        TrainingSettings(n_epochs=1, n_last_epochs=5)


def test_rounded_epochs():
    settings = TrainingSettings(n_epochs=5, n_int8_epochs=2)
    assert [settings.is_rounded_in(i) for i in range(5)] == [False] * 3 + [True] * 2
    assert not TrainingSettings(n_epochs=5).is_rounded_in(4)
    with pytest.raises(TrainingError, match=r"--int8-epochs: .*--epochs.* 5"):
        TrainingSettings(n_epochs=1, n_int8_epochs=5)


@pytest.mark.parametrize("option", ["last", "int8"])
def test_checkpoint_without_the_number_of_last_epochs(option):
    saved = {"model": "road"}
    check_same_run(Path(LAST), saved, saved | {f"n_{option}_epochs": 0})
    with pytest.raises(CheckpointError, match=f"--{option}-epochs 3"):
        check_same_run(Path(LAST), saved, saved | {f"n_{option}_epochs": 3})


@pytest.mark.train
def test_blocks_are_rounded_in_the_last_epochs(sets, tmp_path):
    run = training(sets, tmp_path, replace(SMALL, n_epochs=3, n_int8_epochs=1), name="road")
    seen = []

    class Listener(Quiet):
        def epoch(self, row):
            blocks = [
                module for module in run.network.modules() if isinstance(module, ConvolutionBlock)
            ]
            seen.append({block.is_rounded for block in blocks})

    run.run(Listener())
    assert seen == [{False}, {False}, {True}]


@pytest.mark.train
def test_best_checkpoint_is_one_of_the_rounded_epochs(sets, tmp_path):
    run = training(sets, tmp_path, replace(SMALL, n_epochs=4, n_int8_epochs=2, validate_every=1))
    ap50, saved = iter((0.6, 0.7, 0.5, 0.4)), []

    class Scores(NamedTuple):
        ap50: float
        by_class: dict[int, float]

        def mean(self, _name: str) -> float:
            return self.ap50

    run.scores = lambda listener=None: Scores(next(ap50), {})

    class Listener(Quiet):
        def epoch(self, row):
            saved.append(load_checkpoint(tmp_path / BEST)["history"][-1]["epoch"])

    run.run(Listener())
    assert saved == [1, 2, 3, 3]


@pytest.mark.train
def test_initial_weights_of_another_run(sets, tmp_path):
    first = training(sets, tmp_path / "first", replace(SMALL, n_epochs=2))
    first.run(Quiet())
    second = training(sets, tmp_path / "second", replace(SMALL, seed=5))
    second.start_from(tmp_path / "first" / BEST)
    assert torch.equal(weights(second), weights(first))
    road = training(sets, tmp_path / "road", name="road")
    road.start_from(tmp_path / "first" / BEST)
    for run in (road.network, road.average.network):
        assert all(
            torch.equal(value, first.average.network.body.state_dict()[key])
            for key, value in run.body.state_dict().items()
        )
    other = training(sets, tmp_path / "other", name="yolov4-tiny")
    with pytest.raises(CheckpointError, match=r"best\.pt: .*--model"):
        other.start_from(tmp_path / "first" / BEST)


@pytest.mark.train
def test_initial_weights_are_the_mean_of_several_checkpoints(sets, tmp_path):
    runs = [
        training(sets, tmp_path / str(seed), replace(SMALL, n_epochs=1, seed=seed))
        for seed in (1, 2)
    ]
    for run in runs:
        run.run(Quiet())
    mean = training(sets, tmp_path / "mean")
    mean.start_from(*(tmp_path / seed / LAST for seed in "12"))
    first, second = (run.average.network.state_dict() for run in runs)
    for network in (mean.network, mean.average.network):
        for name, value in network.state_dict().items():
            expected = (
                (first[name] + second[name]) / 2 if value.is_floating_point() else first[name]
            )
            assert torch.allclose(value, expected, atol=1e-6), name
    other = training(sets, tmp_path / "other", replace(SMALL, n_epochs=1), name="road")
    other.run(Quiet())
    with pytest.raises(CheckpointError, match=r"other.last\.pt: .*yolov5n.*road"):
        mean.start_from(tmp_path / "1" / LAST, tmp_path / "other" / LAST)


def test_mean_of_different_networks_is_refused(tmp_path):
    identity, average = {"model": "road", "classes": ["car", "person"]}, {"head": torch.zeros(2, 3)}
    cases = {
        "classes car, person as in .*, got person, car;": (
            identity | {"classes": ["person", "car"]},
            average,
        ),
        "model road as in .*, got unknown;": ({"classes": ["car", "person"]}, average),
        r"weights head of shape \(2, 3\) as in .*, got \(3, 2\);": (
            identity,
            {"head": torch.zeros(3, 2)},
        ),
        r"weights head of shape \(2, 3\) as in .*, got none;": (identity, {}),
        r"weights attention of shape none as in .*, got \(1,\);": (
            identity,
            average | {"attention": torch.zeros(1)},
        ),
    }
    save_checkpoint(tmp_path / BEST, {"identity": identity, "average": average})
    for message, (other, weights_of_other) in cases.items():
        save_checkpoint(tmp_path / LAST, {"identity": other, "average": weights_of_other})
        with pytest.raises(CheckpointError, match=r"last\.pt: expected " + message):
            load_mean([tmp_path / BEST, tmp_path / LAST])


def test_nan_loss_ends_the_run(sets, tmp_path):
    diverging = replace(
        SMALL, schedule=ScheduleSettings(optimiser="sgd", learning_rate=1e9, warmup_epochs=0.1)
    )
    with pytest.raises(TrainingError, match="NaN"):
        training(sets, tmp_path, diverging).run(Quiet())


def failing(sets, out, error):
    """A training with a network that raises an error when it gets images."""

    def fail(network, images):
        raise error

    run = training(sets, out)
    run.network.register_forward_pre_hook(fail)
    return run


def test_out_of_memory_suggests_batch_size(sets, tmp_path):
    error = RuntimeError(
        "[enforce fail at alloc_cpu.cpp:121] DefaultCPUAllocator: can't allocate memory"
    )
    with pytest.raises(TrainingError, match=r"memory.* --batch 2"):
        failing(sets, tmp_path, error).run(Quiet())


def test_other_errors_are_not_caught(sets, tmp_path):
    with pytest.raises(IndexError):
        failing(sets, tmp_path, IndexError()).run(Quiet())


def batch_of(sets, seed, epoch, n=0):
    maker = BatchMaker(sets.train, size_px=96, batch_size=5, seed=seed)
    return list(maker.epoch(epoch, AugmentationSettings()))[n]


def test_batches_depend_on_seed_and_epoch_only(sets):
    first, again = batch_of(sets, 0, 3), batch_of(sets, 0, 3)
    assert torch.equal(first.images, again.images)
    assert torch.equal(first.objects.cxcywh, again.objects.cxcywh)
    assert not torch.equal(first.images, batch_of(sets, 0, 4).images)
    assert not torch.equal(first.images, batch_of(sets, 1, 3).images)


def test_every_image_once_per_epoch(sets):
    maker = BatchMaker(sets.train, size_px=96, batch_size=5, seed=0)
    batches = list(maker.epoch(0, PLAIN))
    assert [len(batch.images) for batch in batches] == [5, 5, 2] == [5] * (len(maker) - 1) + [2]
    labels = sum(len(sets.train.load(i).xyxy) for i in range(len(sets.train)))
    assert sum(len(batch.objects.image) for batch in batches) == labels


def test_single_leftover_image_is_skipped(sets):
    for batch_size, sizes in ((11, [11]), (5, [5, 5, 2]), (12, [12]), (50, [12])):
        maker = BatchMaker(sets.train, size_px=96, batch_size=batch_size, seed=0)
        actual = [len(batch.images) for batch in maker.epoch(0, PLAIN)]
        assert (actual, len(maker)) == (sizes, len(sizes))


def test_learning_rate_warmup_and_cosine():
    schedule = Schedule(SGD, n_epochs=100, n_steps_per_epoch=10)
    optimiser = optimiser_of(make_network("yolov5n", 2), SGD)
    rates = []
    for step in (0, 15, 30, 500, 1000):
        schedule.set(optimiser, step)
        rates.append({group["name"]: group["lr"] for group in optimiser.param_groups})
    assert rates[0] == {"weight": 0.0, "norm": 0.0, "bias": pytest.approx(0.1)}
    assert rates[1]["weight"] == pytest.approx(0.5 * schedule.rate(15))
    assert {name: pytest.approx(schedule.rate(30)) for name in rates[2]} == rates[2]
    assert rates[3]["weight"] == pytest.approx(0.01 * (0.01 + 0.99 / 2))
    assert rates[4]["weight"] == pytest.approx(0.01 * 0.01)
    decays = {group["name"]: group["weight_decay"] for group in optimiser.param_groups}
    assert decays == {"weight": 5e-4, "norm": 0.0, "bias": 0.0}


def test_ema_follows_the_weights():
    network = make_network("yolov5n", 2)
    average = WeightAverage(network)
    before = average.network.heads[0].bias.clone()
    with torch.no_grad():
        network.heads[0].bias.add_(1.0)
    average.update(network, 0.9)
    assert torch.allclose(average.network.heads[0].bias, before + 0.1, atol=1e-6)
    schedule = Schedule(ScheduleSettings(), n_epochs=10, n_steps_per_epoch=100)
    decays = [schedule.average_decay(step) for step in (0, 10, 999)]
    assert decays == sorted(decays)
    assert decays[0] < 0.2
    assert decays[2] == pytest.approx(1 - 1 / 40, abs=1e-3)


@pytest.mark.train
def test_student_learns_without_labels(sets, tmp_path):
    """Images without labels and without completely labelled classes: only the teacher detects
    cars."""
    prepare_torch(seed=1)
    network = make_network("yolov5n", 2)
    with torch.no_grad():
        for head in network.heads:  # a teacher that detects cars everywhere
            head.bias.view(3, -1)[:, 4] = 3.0
            head.bias.view(3, -1)[:, 5] = 3.0
    export_onnx(network.eval(), tmp_path / "teacher.onnx", {"names": ["car", "person"]})
    teacher = Teacher(tmp_path / "teacher.onnx", sets.road_class_id, device="cpu")

    class Unlabelled:
        def __len__(self):
            return len(sets.train)

        def load(self, index):
            item = sets.train.load(index)
            none = np.zeros(0, np.int64)
            return replace(
                item,
                xyxy=item.xyxy[:0],
                class_index=none,
                is_ignored=none == 1,
                is_complete=~item.is_complete,
            )

    objectness = {}
    quick = replace(SMALL, n_epochs=10, schedule=replace(SMALL.schedule, learning_rate=0.02))
    for name, used in (("with", teacher), ("without", None)):
        run = training(replace(sets, train=Unlabelled()), tmp_path / name, quick, teacher=used)
        run.run(Quiet())
        with torch.no_grad():
            heads = run.network.eval()(torch.zeros(1, 3, 96, 96))
        objectness[name] = float(heads[0][..., 4].sigmoid().mean())
    assert objectness["with"] > 0.5 > 0.2 > objectness["without"]


@pytest.mark.slow
def test_teacher_without_road_classes(sets, tmp_path):
    export_onnx(
        make_network("yolov5n", 2).eval(), tmp_path / "pets.onnx", {"names": ["cat", "dog"]}
    )
    with pytest.raises(ModelError, match=r"pets\.onnx: .*classes"):
        Teacher(tmp_path / "pets.onnx", sets.road_class_id, device="cpu")
