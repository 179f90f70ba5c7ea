"""FeatureLoss: correlation of channels, and a student that imitates a teacher."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from tests.detection.training.short_trainings import SMALL, Killed, Quiet, weights
from track_range.detection.training.errors import CheckpointError
from track_range.detection.training.feature_loss import FeatureLoss, correlation
from track_range.detection.training.networks.registry import make_network
from track_range.detection.training.teacher import Teacher
from track_range.detection.training.train import Training, export_onnx, prepare_torch


def test_correlation_is_that_of_numpy():
    generator = torch.Generator().manual_seed(0)
    first = torch.randn(3, 2, 5, 4, generator=generator)
    second = 0.5 * first + torch.randn(3, 2, 5, 4, generator=generator)
    expected = [np.corrcoef(first[:, i].ravel(), second[:, i].ravel())[0, 1] for i in range(2)]
    assert correlation(first, second).tolist() == pytest.approx(expected, abs=1e-5)
    assert correlation(first, -3 * first + 1).tolist() == pytest.approx([-1, -1], abs=1e-5)
    assert correlation(torch.ones_like(first), second).tolist() == pytest.approx([0, 0], abs=1e-5)


@pytest.fixture(scope="module")
def teacher(tmp_path_factory, sets):
    prepare_torch(seed=1)
    path = tmp_path_factory.mktemp("teacher") / "teacher.onnx"
    network = make_network("yolov5n", 2).train()
    with torch.no_grad():
        for _ in range(30):  # so that the statistics of its batch norms are those of its features
            network(torch.rand(4, 3, 64, 64))
    export_onnx(network.eval(), path, {"names": ["car", "person"]})
    return Teacher(path, sets.road_class_id, device="cpu")


def run_of(sets, out, teacher, settings=SMALL):
    out.mkdir(exist_ok=True)
    prepare_torch(seed=settings.seed)
    return Training(make_network("road", 2), settings, sets, out, teacher=teacher)


@pytest.mark.slow
def test_loss_of_own_features_is_zero(teacher):
    student = make_network("road", 2).eval()
    student.body.load_state_dict(teacher.network.body.state_dict(), strict=False)
    loss = FeatureLoss(teacher, student)
    images = torch.rand(2, 3, 64, 64, generator=torch.Generator().manual_seed(0))
    features = teacher.features(images)
    for predictor in loss.predictors:
        torch.nn.init.dirac_(predictor.weight)
    with torch.no_grad():
        assert float(loss([*features, features[-1]], images)) == pytest.approx(0, abs=1e-3)
        opposite = float(loss([-level for level in features], images))
    assert opposite == pytest.approx(12, abs=1e-2)  # 2 * 3 levels * (1 + 1)
    loss(student.features(images), images).backward()
    assert student.body.to_p3[0].conv.weight.grad.abs().max() > 0
    assert all(parameter.grad is None for parameter in teacher.network.parameters())


@pytest.mark.train
def test_features_of_the_teacher_are_learnt_and_runs_resume_exactly(sets, tmp_path, teacher):
    quick = replace(SMALL, n_epochs=6, schedule=replace(SMALL.schedule, learning_rate=0.01))
    straight = run_of(sets, tmp_path / "straight", teacher, quick)
    straight.run(Quiet())
    losses = [row["loss_features"] for row in straight.history]
    assert losses[-1] < 0.8 * losses[0]

    killed = run_of(sets, tmp_path / "killed", teacher, quick)
    with pytest.raises(KeyboardInterrupt):
        killed.run(Killed())
    resumed = run_of(sets, tmp_path / "killed", teacher, quick)
    resumed.resume()
    resumed.run(Quiet())
    assert torch.equal(weights(resumed), weights(straight))

    further = run_of(sets, tmp_path / "further", teacher, quick)
    further.start_from(tmp_path / "straight" / "last.pt")
    assert torch.equal(
        further._feature_loss.predictors[0].weight, straight._feature_loss.predictors[0].weight
    )
    alone = run_of(sets, tmp_path / "straight", None, quick)
    with pytest.raises(CheckpointError, match="--teacher"):
        alone.resume()
