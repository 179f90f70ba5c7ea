"""One small world, written in the layout of each data set, and read back as labels."""

import csv
import json
from pathlib import Path

import cv2
import numpy as np
import pyarrow as pa
import pytest
from pyarrow import feather, parquet
from scipy.spatial.transform import Rotation

import track_range as tr
from track_range.evaluation.datasets.convert import ConvertSettings, convert
from track_range.evaluation.datasets.drive import DatasetError
from track_range.foundation.errors import UsageError

N_FRAMES, START_S = 14, 1_600_000_000.0
F_PX, CX_PX, CY_PX, SIZE_PX = 500.0, 320.0, 180.0, (640, 360)
POSE = ("qw", "qx", "qy", "qz", "tx_m", "ty_m", "tz_m")
# camera axes right, down, forward in a world with z up, in which it drives along x at 5 m/s
WORLD_FROM_CAMERA = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
CAMERA_QUATERNION = Rotation.from_matrix(WORLD_FROM_CAMERA).as_quat(scalar_first=True).tolist()
CAR, WALKER, SIGN = "car-1", "walker", "sign"


def times_s():
    return START_S + 0.1 * np.arange(N_FRAMES)


def camera_m(frame):
    return [0.5 * frame, 0.0, 1.5]


def objects(frame):
    """Name, middle in the world, yaw, size: a car ahead at 8 m/s, turned by 10 degrees; a person who
    stands to the left; a sign."""
    yield CAR, [20.0 + 0.8 * frame, -1.0, 0.75], np.radians(10.0), [4.4, 1.8, 1.5]
    yield WALKER, [25.0, 4.0, 0.9], np.radians(-90.0), [0.6, 0.6, 1.8]
    yield SIGN, [30.0, 6.0, 2.0], 0.0, [0.2, 0.8, 0.8]


def quaternion(yaw_rad):
    return Rotation.from_euler("z", yaw_rad).as_quat(scalar_first=True).tolist()


def cuboid_rows(kinds):
    for frame, time_s in enumerate(times_s().tolist()):
        for name, middle_m, yaw_rad, lwh_m in objects(frame):
            yield frame, time_s, name, kinds[name], middle_m, yaw_rad, lwh_m


def camera_json():
    return {"fx": F_PX, "fy": F_PX, "cx": CX_PX, "cy": CY_PX}


def images(folder, names):
    folder.mkdir(parents=True)
    for name in names:
        assert cv2.imwrite(str(folder / name), np.full((*SIZE_PX[::-1], 3), 90, np.uint8))


def write_av2(folder):
    """The labels are in the frame of the vehicle, whose origin is 1 m behind the camera on the
    road; the poses are of 20 Hz, in any order."""
    (folder / "calibration").mkdir(parents=True)
    kinds = {CAR: "REGULAR_VEHICLE", WALKER: "PEDESTRIAN", SIGN: "SIGN"}
    rows = []
    for frame, time_s, name, kind, middle_m, yaw_rad, lwh_m in cuboid_rows(kinds):
        placed = [middle_m[0] - 0.5 * frame + 1.0, *middle_m[1:], *lwh_m]
        named = dict(
            zip(("tx_m", "ty_m", "tz_m", "length_m", "width_m", "height_m"), placed, strict=True)
        )
        turn = dict(zip(POSE, quaternion(yaw_rad), strict=False))
        stamp = {"timestamp_ns": round(time_s * 1e9), "track_uuid": name, "category": kind}
        rows.append({**stamp, **named, **turn, "num_interior_pts": 30})
    feather.write_feather(pa.Table.from_pylist(rows), folder / "annotations.feather")
    ego_s = np.arange(-0.1, 1.6, 0.05)[::-1]
    ego = [
        {
            "timestamp_ns": round((START_S + t) * 1e9),
            **dict(zip(POSE, [1, 0, 0, 0, 5 * t - 1, 0, 0], strict=True)),
        }
        for t in ego_s.tolist()
    ]
    feather.write_feather(
        pa.Table.from_pylist(
            [{k: float(v) if k != "timestamp_ns" else v for k, v in one.items()} for one in ego]
        ),
        folder / "city_SE3_egovehicle.feather",
    )
    lens = {f"{key}_px": value for key, value in camera_json().items()} | {
        "k1": 0.0,
        "k2": 0.0,
        "k3": 0.0,
    }
    size = {"width_px": SIZE_PX[0], "height_px": SIZE_PX[1]}
    mount = dict(zip(POSE, [*CAMERA_QUATERNION, 1.0, 0.0, 1.5], strict=True))
    for file in ("intrinsics", "egovehicle_SE3_sensor"):
        table = pa.Table.from_pylist(
            [{"sensor_name": "ring_front_center", **lens, **size, **mount}]
        )
        feather.write_feather(table, folder / "calibration" / f"{file}.feather")
    names = [f"{round(t * 1e9)}.jpg" for t in (START_S + np.arange(2 * N_FRAMES) * 0.05).tolist()]
    images(folder / "sensors/cameras/ring_front_center", names)
    return folder


def write_pandaset(folder):
    (folder / "meta").mkdir(parents=True)
    (folder / "annotations/cuboids").mkdir(parents=True)
    of_camera = folder / "camera/front_camera"
    of_camera.mkdir(parents=True)
    poses = [
        {
            "heading": dict(zip("wxyz", CAMERA_QUATERNION, strict=True)),
            "position": dict(zip("xyz", camera_m(frame), strict=True)),
        }
        for frame in range(N_FRAMES)
    ]
    lens = {"fx": F_PX, "fy": F_PX, "cx": CX_PX + 640.0, "cy": CY_PX + 360.0}  # of 1920 x 1080
    contents = {"intrinsics": lens, "poses": poses, "timestamps": times_s().tolist()}
    for name, content in contents.items():
        (of_camera / f"{name}.json").write_text(json.dumps(content))
    (folder / "meta/timestamps.json").write_text(json.dumps(times_s().tolist()))
    for frame in range(N_FRAMES):
        with (folder / f"annotations/cuboids/{frame:02d}.csv").open("w") as file:
            writer = csv.writer(file)
            place, size = ([f"{part}.{k}" for k in "xyz"] for part in ("position", "dimensions"))
            writer.writerow(
                ["uuid", "label", "yaw", *place, *size, "cuboids.sensor_id", "cuboids.sibling_id"]
            )
            kinds = {CAR: "Car", WALKER: "Pedestrian with Object", SIGN: "Signs"}
            for name, (x, y, z), yaw_rad, (length, width, height) in objects(frame):
                row = [kinds[name], yaw_rad - np.pi / 2, x, y, z, width, length, height]
                writer.writerow(
                    [name, *row, 0 if name == CAR else -1, "twin" if name == CAR else ""]
                )
                if name == CAR:  # the same car by the lidar that looks ahead
                    writer.writerow(["twin", *row, 1, CAR])
    return folder


def write_kitti360(folder):
    drive = "2013_05_28_drive_0000_sync"
    poses = folder / "data_poses" / drive
    boxes = folder / "data_3d_bboxes/train"
    for place in (poses, boxes, folder / "calibration"):
        place.mkdir(parents=True)
    P = f"{F_PX} 0 {CX_PX} 0 0 {F_PX} {CY_PX} 0 0 0 1 0"
    size = f"S_rect_00: {SIZE_PX[0]} {SIZE_PX[1]}"
    (folder / "calibration/perspective.txt").write_text(f"{size}\nP_rect_00: {P}\n")
    lines = []
    for frame in range(N_FRAMES):
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = WORLD_FROM_CAMERA, camera_m(frame)
        lines.append(" ".join(map(str, [250 + frame, *pose.ravel()])))
    (poses / "cam0_to_world.txt").write_text("\n".join(lines) + "\n")
    unit = np.stack(np.meshgrid(*[[-0.5, 0.5]] * 3), axis=-1).reshape(-1, 3)
    nodes = []
    kinds = {CAR: ("car", 26), WALKER: ("person", 24), SIGN: ("trafficSign", 20)}
    for frame in range(N_FRAMES):
        for name, middle_m, yaw_rad, lwh_m in objects(frame):
            if name != CAR and frame:
                continue  # static, once
            transform = np.eye(4)
            transform[:3, :3] = Rotation.from_euler("z", yaw_rad).as_matrix() * lwh_m
            transform[:3, 3] = middle_m
            label, semantic = kinds[name]
            values = {
                "index": len(nodes),
                "label": label,
                "semanticId": semantic,
                "instanceId": 1,
                "timestamp": 250 + frame if name == CAR else -1,
                "start_frame": 250,
                "end_frame": 400,
            }
            text = "".join(f"<{key}>{value}</{key}>" for key, value in values.items())
            for key, matrix in (("transform", transform), ("vertices", unit)):
                data = " ".join(f"{value:.8f}" for value in matrix.ravel())
                text += f"<{key}><rows>{len(matrix)}</rows><data>\n{data}</data></{key}>"
            nodes.append(f"<object{len(nodes)}>{text}</object{len(nodes)}>")
    (boxes / f"{drive}.xml").write_text(f"<?xml version='1.0'?><storage>{''.join(nodes)}</storage>")
    return folder


def write_nuscenes(folder):
    kinds = {CAR: "vehicle.car", WALKER: "human.pedestrian.adult", SIGN: "movable_object.barrier"}
    frames = range(N_FRAMES)
    stamps = [round(time * 1e6) for time in times_s().tolist()]
    mount = {"rotation": CAMERA_QUATERNION, "translation": [1.0, 0.0, 1.5]}
    K = [[F_PX, 0, CX_PX], [0, F_PX, CY_PX], [0, 0, 1]]
    tables = {
        "scene": [{"token": "s", "name": "scene-0001"}],
        "sample": [{"token": f"k{n}", "scene_token": "s", "timestamp": stamps[n]} for n in frames],
        "sensor": [{"token": name, "channel": name} for name in ("CAM_FRONT", "CAM_BACK")],
        "calibrated_sensor": [
            {"token": f"c-{name}", "sensor_token": name, "camera_intrinsic": K, **mount}
            for name in ("CAM_FRONT", "CAM_BACK")
        ],
        "ego_pose": [
            {"token": f"e{n}", "rotation": [1, 0, 0, 0], "translation": [0.5 * n - 1, 0, 0]}
            for n in frames
        ],
        "sample_data": [
            {
                "token": f"{name}{n}",
                "sample_token": f"k{n}",
                "ego_pose_token": f"e{n}",
                "calibrated_sensor_token": f"c-{name}",
                "timestamp": stamps[n],
                "is_key_frame": True,
                "filename": f"samples/{name}/{n}.jpg",
                "width": SIZE_PX[0],
                "height": SIZE_PX[1],
            }
            for name in ("CAM_BACK", "CAM_FRONT")
            for n in reversed(frames)
        ],
        "instance": [{"token": name, "category_token": kind} for name, kind in kinds.items()],
        "category": [{"token": kind, "name": kind} for kind in kinds.values()],
        "sample_annotation": [
            {
                "token": f"{name}{frame}",
                "sample_token": f"k{frame}",
                "instance_token": name,
                "translation": middle_m,
                "rotation": quaternion(yaw_rad),
                "size": [lwh_m[1], lwh_m[0], lwh_m[2]],
                "num_lidar_pts": 12,
            }
            for frame, _, name, _, middle_m, yaw_rad, lwh_m in cuboid_rows(kinds)
        ],
    }
    (folder / "v1.0-mini").mkdir(parents=True)
    for name, rows in tables.items():
        (folder / f"v1.0-mini/{name}.json").write_text(json.dumps(rows))
    return folder


def write_tables(folder):
    folder.mkdir(parents=True)
    camera = f"fx_px: {F_PX}, fy_px: {F_PX}, cx_px: {CX_PX}, cy_px: {CY_PX}"
    size = f"width_px: {SIZE_PX[0]}, height_px: {SIZE_PX[1]}"
    (folder / "rig.yaml").write_text(
        f"track_range_rig: 1\nleft: {{{camera}, {size}, distortion: []}}\n"
    )
    lines = [",".join(("time_s", *POSE, "image"))]
    for frame, time_s in enumerate(times_s().tolist()):
        lines.append(",".join(map(str, (time_s, *CAMERA_QUATERNION, *camera_m(frame), ""))))
    (folder / "frames.csv").write_text("\n".join(lines) + "\n")
    kinds = {CAR: "TYPE_VEHICLE", WALKER: "TYPE_PEDESTRIAN", SIGN: "TYPE_SIGN"}
    names = ("length_m", "width_m", "height_m")
    rows = [
        {
            "frame": frame,
            "time_s": time_s,
            "track": name,
            "class": kind,
            "points": -1,
            **dict(zip(POSE, [*quaternion(yaw_rad), *middle_m], strict=True)),
            **dict(zip(names, lwh_m, strict=True)),
        }
        for frame, time_s, name, kind, middle_m, yaw_rad, lwh_m in cuboid_rows(kinds)
    ]
    parquet.write_table(pa.Table.from_pylist(rows), folder / "cuboids.parquet")
    return folder


WRITERS = {
    "av2": write_av2,
    "pandaset": write_pandaset,
    "kitti360": write_kitti360,
    "nuscenes": write_nuscenes,
    "waymo-like": write_tables,
}


def converted(data, folder):
    source, out = WRITERS[data](folder / data), folder / "out"
    lines = convert(ConvertSettings.of({"data": data, "source": source, "out": out}))
    assert len(lines) == 1
    name = next((out / "label_02").iterdir()).stem
    return out, name, lines[0]


@pytest.mark.parametrize("data", WRITERS)
def test_the_same_world_in_each_layout(data, tmp_path):
    out, name, line = converted(data, tmp_path)
    assert f"{N_FRAMES} frames, {2 * N_FRAMES} labels of 2 objects" in line
    rows = [row.split() for row in (out / f"label_02/{name}.txt").read_text().splitlines()]
    for frame in range(N_FRAMES):
        car, walker = sorted((row for row in rows if int(row[0]) == frame), key=lambda row: row[2])
        assert (car[2], walker[2]) == ("Car", "Pedestrian")
        x_m, y_m, z_m, yaw_rad = map(float, car[13:17])
        assert (x_m, y_m, z_m) == pytest.approx((1.0, 1.5, 20.0 + 0.3 * frame), abs=2e-3)
        assert yaw_rad == pytest.approx(np.radians(-100.0), abs=1e-3)  # 10 degrees left of ahead
        assert list(map(float, car[10:13])) == pytest.approx([1.5, 1.8, 4.4], abs=1e-3)
        z_m = 25.0 - 0.5 * frame
        assert list(map(float, walker[13:16])) == pytest.approx([-4.0, 1.5, z_m], abs=2e-3)
        cx_px, cy_px = (CX_PX, CY_PX) if data != "pandaset" else (CX_PX + 640, CY_PX + 360)
        top_px = cy_px + F_PX * (1.5 - 1.8) / (z_m - 0.3)
        assert float(walker[7]) == pytest.approx(top_px, abs=0.02)
        assert float(walker[8]) == pytest.approx(cx_px - F_PX * 3.7 / (z_m + 0.3), abs=0.05)
    speeds = np.genfromtxt(out / f"ego/{name}.csv", delimiter=",", names=True)
    assert speeds["speed_mps"] == pytest.approx(
        5.0 * (0.1 / 0.1037 if data == "kitti360" else 1), abs=1e-3
    )
    with (out / f"truth/{name}.csv").open() as file:
        truth = [row for row in csv.DictReader(file) if row["class"].lower() == "car"]
    middle = truth[N_FRAMES // 2]
    # the rear of the car, whose middle is 2.2 m cos(10 deg) behind it
    assert float(middle["distance_m"]) == pytest.approx(20.0 + 0.3 * 7 - 2.2, abs=0.2)
    assert float(middle["closing_mps"]) == pytest.approx(
        -3.0 * (0.1 / 0.1037 if data == "kitti360" else 1), abs=0.01
    )
    assert float(middle["visible_share"]) == 1.0


@pytest.mark.slow
def test_evaluations_read_what_was_converted(tmp_path, cli):
    """Boxes of the labels give the distances, the motion and the cuboids; tracks are those of the
    labels; a run with the images is compared with the table."""
    out, name, _ = converted("av2", tmp_path)
    given = {"labels": out / "label_shape", "calib": out / "calib"}
    ranges = tr.evaluate.ranges(**given, methods=("mono",))
    assert ranges["literature"]["mono"]["all"]["n"] == 2 * N_FRAMES
    assert ranges["literature"]["mono"]["all"]["delta_1_25"] > 0.9
    assert tr.evaluate.motion(**given, poses=out / "poses")["n_boxes"] == 2 * N_FRAMES
    cuboids = tr.evaluate.cuboids(**given, poses=out / "poses")["cuboids"]
    assert cuboids["counts"]["vehicles"]["n"] == N_FRAMES
    assert tr.evaluate.tracks(out / "label_02", out / "label_02", truth_format="kitti")
    assert len(list((out / name).glob("*.jpg"))) == N_FRAMES
    files = {"rig": "calib", "detections": "label_shape", "truth": "label_02"}
    options = [
        value
        for key, folder in files.items()
        for value in (f"--{key}", out / folder / f"{name}.txt")
    ]
    speed = ("--ego-speed", out / f"ego/{name}.csv")
    status, _, errors = cli(
        "run", "--mono", out / name, *options, *speed, "--out", tmp_path / "run"
    )
    assert status == 0, errors
    figures = tr.evaluate.run(tmp_path / "run")
    assert figures["methods"]["mono"]["n"] >= N_FRAMES
    assert figures["methods"]["mono"]["delta_1_25"] > 0.9
    assert figures["cuboids"]["counts"]["all"]["n"] >= N_FRAMES


def test_pickles_are_not_read(tmp_path):
    folder = write_pandaset(tmp_path / "002")
    for file in (folder / "annotations/cuboids").iterdir():
        file.rename(file.with_suffix(".pkl.gz"))
    with pytest.raises(DatasetError, match=r"pickles can run any code.*read_pickle"):
        convert(ConvertSettings.of({"data": "pandaset", "source": folder, "out": tmp_path / "out"}))


@pytest.mark.parametrize(
    ("file", "content", "message"),
    [
        ("cuboids.parquet", b"none", "cuboids.parquet: expected the columns frame"),
        ("frames.csv", b"time_s,qw\n1,2\n", "frames.csv: expected the columns time_s"),
        (
            "frames.csv",
            ",".join(("time_s", *POSE, "image")).encode() + b"\n1,1,0,0,0,0,0,0,\n",
            "rows of frames.csv",
        ),
    ],
)
def test_damaged_tables(tmp_path, file, content, message):
    folder = write_tables(tmp_path / "drive")
    (folder / file).write_bytes(content)
    with pytest.raises(DatasetError, match=message):
        convert(
            ConvertSettings.of({"data": "waymo-like", "source": folder, "out": tmp_path / "out"})
        )


def test_other_files_of_kitti360(tmp_path):
    folder = write_kitti360(tmp_path / "k")
    settings = ConvertSettings.of({"data": "kitti360", "source": folder, "out": tmp_path / "out"})
    convert(settings)
    place = folder / "calibration/perspective.txt"
    left = place.read_text()
    right = left.replace(" 0 0 ", f" {-0.6 * F_PX} 0 ", 1).replace("_00", "_01")
    place.write_text(left + right)  # 0.6 m beside the camera whose poses are given
    convert(settings.model_copy(update={"camera": "image_01", "out": tmp_path / "right"}))
    left_m, right_m = (
        np.loadtxt(next((tmp_path / out / "label_02").iterdir()), usecols=[13, 15])[0]
        for out in ("out", "right")
    )
    np.testing.assert_allclose(right_m, left_m - [0.6, 0.0], atol=1e-3)
    boxes = next((folder / "data_3d_bboxes").rglob("*.xml"))
    boxes.write_text('<?xml version="1.0"?><!DOCTYPE a [<!ENTITY b "c">]><a>&b;</a>')
    with pytest.raises(DatasetError, match="document type"):
        convert(settings)
    (folder / "calibration/perspective.txt").write_text("S_rect_00: 1 2\n")
    with pytest.raises(DatasetError, match="rows of 4 numbers"):
        convert(settings)


def test_tables_of_nuscenes_with_other_keys(tmp_path):
    folder = write_nuscenes(tmp_path / "n")
    (folder / "v1.0-mini/scene.json").write_text('[{"token": "s"}]')
    with pytest.raises(DatasetError, match=r"expected the files of nuscenes.*'name'"):
        convert(ConvertSettings.of({"data": "nuscenes", "source": folder, "out": tmp_path / "o"}))


def test_an_image_of_nuscenes_is_missing(tmp_path):
    """It is named, and does not make a drive without images."""
    folder = write_nuscenes(tmp_path / "n")
    images(folder / "samples/CAM_FRONT", ["0.jpg"])
    given = {"data": "nuscenes", "source": folder, "out": tmp_path / "o"}
    with pytest.raises(DatasetError, match=r"expected an image for each of .* found 1"):
        convert(ConvertSettings.of(given))


def test_a_drive_without_all_images_has_no_labels(tmp_path):
    folder, out = write_tables(tmp_path / "drive"), tmp_path / "out"
    settings = ConvertSettings.of({"data": "waymo-like", "source": folder, "out": out})
    head, *rows = (folder / "frames.csv").read_text().splitlines()
    for images, message in ((["a.jpg"], "for each of"), ([], r"absent\.jpg: no such file")):
        names = images + (len(rows) - len(images)) * ["" if images else "absent.jpg"]
        lines = [head, *(row + name for row, name in zip(rows, names, strict=True))]
        (folder / "frames.csv").write_text("\n".join(lines) + "\n")
        with pytest.raises(DatasetError, match=message):
            convert(settings)
        assert not (out / "label_02").exists()
    (folder / "frames.csv").unlink()
    with pytest.raises(DatasetError, match=r"frames\.csv: no such file; expected a table with"):
        convert(settings)


def test_unknown_camera(tmp_path):
    folder = write_av2(tmp_path / "log")
    given = {"data": "av2", "source": folder, "out": tmp_path / "out", "camera": "front"}
    with pytest.raises(
        DatasetError, match=r"found ring_front_center; give one of them with --camera"
    ):
        convert(ConvertSettings.of(given))


def test_tables_have_a_single_camera(tmp_path):
    given = {"data": "waymo-like", "source": tmp_path, "out": tmp_path / "out", "camera": "FRONT"}
    with pytest.raises(UsageError, match="--camera FRONT: expected no camera with waymo-like"):
        convert(ConvertSettings.of(given))


def original_log(shared: Path, name: str, folder: Path) -> Path:
    """A log of Argoverse 2 in its original files, from the given tables with other names."""
    (folder / "calibration").mkdir(parents=True)
    table = parquet.read_table(shared / f"annotations/{name}.parquet")
    zeros = pa.array(np.zeros(len(table)))
    names = {
        "time_ns": "timestamp_ns",
        "id": "track_uuid",
        "class": "category",
        "points": "num_interior_pts",
    }
    table = table.rename_columns([names.get(one, one) for one in table.schema.names])
    table = table.append_column("qx", zeros).append_column("qy", zeros)
    feather.write_feather(table, folder / "annotations.feather")
    poses = parquet.read_table(shared / f"annotations/{name}.poses.parquet")
    renamed = poses.rename_columns([names.get(one, one) for one in poses.schema.names])
    feather.write_feather(renamed, folder / "city_SE3_egovehicle.feather")
    cameras = json.loads((shared / f"cameras/{name}.json").read_text())["ego_from_camera"]
    table = pa.Table.from_pylist([{"sensor_name": key, **one} for key, one in cameras.items()])
    for file in ("intrinsics", "egovehicle_SE3_sensor"):
        feather.write_feather(table, folder / f"calibration/{file}.feather")
    return folder


@pytest.mark.real
@pytest.mark.parametrize("name", ["adcf7d18", "3b3570b4", "3bffdcff"])
def test_given_logs_of_argoverse(shared_data, tmp_path, name):
    """The labels that were made of these logs by other code: the same boxes to 0.01 px, the same
    cuboids, poses and closing speeds; boxes that the camera cuts in two may differ."""
    source = original_log(shared_data / "av2", name, tmp_path / name)
    out = tmp_path / "out"
    convert(ConvertSettings.of({"data": "av2", "source": source, "out": out}))
    given, own = (
        [row.split() for row in (folder / f"label_02/{name}.txt").read_text().splitlines()]
        for folder in (shared_data / "av2", out)
    )
    kinds = {row[2] for row in own}
    numbers = {
        kind: np.array([[row[0], *row[6:17]] for row in own if row[2] == kind], float)
        for kind in kinds
    }
    errors = []
    for row in given:
        others = numbers[row[2]][numbers[row[2]][:, 0] == float(row[0]), 1:]
        distances = np.abs(others - np.array(row[6:17], float)).max(axis=1)
        errors.append(distances.min(initial=np.inf))
    assert np.mean(np.array(errors) < 0.01) > 0.985
    poses = [np.loadtxt(folder / f"poses/{name}.txt") for folder in (shared_data / "av2", out)]
    assert poses[0] == pytest.approx(poses[1], abs=2e-5)
    ego = [
        np.genfromtxt(folder / f"ego/{name}.csv", delimiter=",", names=True)
        for folder in (shared_data / "av2", out)
    ]
    assert ego[0]["speed_mps"] == pytest.approx(ego[1]["speed_mps"], abs=1e-3)


@pytest.mark.real
def test_given_sequence_of_pandaset(shared_data, tmp_path):
    """The cuboids and poses of the front camera in PandaSet's files: the boxes of other code to 0.05
    px, and bodies as high as its, to 1 % (median)."""
    shared, source, out = shared_data / "pandaset", tmp_path / "front", tmp_path / "out"
    ego = np.genfromtxt(shared / "ego/front.csv", delimiter=",", names=True)
    camera = source / "camera/front_camera"
    for place in (camera, source / "meta", source / "annotations/cuboids"):
        place.mkdir(parents=True)
    names = [
        *(("heading", k, f"q{k}") for k in "wxyz"),
        *(("position", k, f"{k}_m") for k in "xyz"),
    ]
    poses = [{"heading": {}, "position": {}} for _ in ego]
    for row, pose in zip(ego, poses, strict=True):
        for part, axis, column in names:
            pose[part][axis] = float(row[column])
    times = ego["stored_time_s"].tolist()
    lens = {"fx": 1970.0131, "fy": 1970.0091, "cx": 970.0002, "cy": 483.2988}
    for name, content in {"intrinsics": lens, "poses": poses, "timestamps": times}.items():
        (camera / f"{name}.json").write_text(json.dumps(content))
    (source / "meta/timestamps.json").write_text(json.dumps(times))
    objects = parquet.read_table(shared / "objects/front.parquet").to_pylist()
    place, size = ([f"{part}.{k}" for k in "xyz"] for part in ("position", "dimensions"))
    header = ["uuid", "label", "yaw", *place, *size, "cuboids.sensor_id", "cuboids.sibling_id"]
    keys = [f"world_{k}_m" for k in "xyz"] + ["width_m", "length_m", "height_m"]
    for frame in range(len(ego)):
        with (source / f"annotations/cuboids/{frame:02d}.csv").open("w") as file:
            writer = csv.writer(file)
            writer.writerow(header)
            for one in objects:
                if one["frame"] == frame:
                    numbers = [one["yaw_rad"] - np.pi / 2, *(one[key] for key in keys)]
                    writer.writerow([one["uid"], one["kind"], *numbers, -1, ""])
    convert(ConvertSettings.of({"data": "pandaset", "source": source, "out": out}))
    given, given_body = (_rows(shared / f"{name}/front.txt") for name in LABELS)
    own, own_body = (_rows(out / f"{name}/front.txt") for name in LABELS)
    errors, heights = [], []
    for row, body in zip(given, given_body, strict=True):
        same = (own[:, 0] == row[0]) & (np.abs(own[:, 8:14] - row[8:14]).max(axis=1) < 0.01)
        for index in np.flatnonzero(same):
            errors.append(np.abs(own[index, 4:8] - row[4:8]).max())
            heights.append(np.ptp(own_body[index, [5, 7]]) / np.ptp(body[[5, 7]]))
    assert len(errors) >= 1560
    assert np.quantile(errors, 0.99) < 0.05  # two objects are labelled twice
    assert np.median(heights) == pytest.approx(1.0, abs=0.015)


LABELS = ("label_02", "label_shape")


def _rows(path):
    """Frame, truncation, occlusion, angle, box, size, place and yaw of labels."""
    rows = [row.split() for row in path.read_text().splitlines()]
    return np.array([[row[0], *row[3:17]] for row in rows], float)


@pytest.mark.real
def test_given_labels_of_nuscenes(shared_data, tmp_path):
    """Labels in the frame of the camera, brought to the world and back by the tables, keep their
    place."""
    given = json.loads((shared_data / "nuscenes/mono3d.json").read_text())
    name, source, out = "CAM_FRONT", tmp_path / "n", tmp_path / "out"
    images = {one["id"]: one for one in given["images"] if f"/{name}/" in one["file_name"]}
    labels = [one for one in given["annotations"] if one["image_id"] in images]
    poses = {
        part: {
            token: (
                Rotation.from_quat(one[f"{part}_rotation"], scalar_first=True).as_matrix(),
                one[f"{part}_translation"],
            )
            for token, one in images.items()
        }
        for part in ("cam2ego", "ego2global")
    }
    stamps = {token: int(one["file_name"].split("__")[-1][:-4]) for token, one in images.items()}
    tables = {
        "scene": [{"token": "s", "name": name}],
        "sensor": [{"token": name, "channel": name}],
        "category": [{"token": one["name"], "name": one["name"]} for one in given["categories"]],
        "sample": [
            {"token": token, "scene_token": "s", "timestamp": stamp}
            for token, stamp in stamps.items()
        ],
        "ego_pose": [_posed(token, one, "ego2global") for token, one in images.items()],
        "calibrated_sensor": [
            _posed(token, one, "cam2ego")
            | {"sensor_token": name, "camera_intrinsic": one["cam_intrinsic"]}
            for token, one in images.items()
        ],
        "sample_data": [
            {
                **dict.fromkeys(("token", "sample_token", "ego_pose_token"), token),
                "calibrated_sensor_token": token,
                "timestamp": stamps[token],
                "is_key_frame": True,
                "filename": one["file_name"],
                "width": one["width"],
                "height": one["height"],
            }
            for token, one in images.items()
        ],
        "instance": [
            {"token": str(one["id"]), "category_token": one["category_name"]} for one in labels
        ],
        "sample_annotation": [],
    }
    for one in labels:
        x, y, z, length, height, width, yaw_rad = one["bbox_cam3d"]
        turn = Rotation.from_euler("y", yaw_rad).as_matrix() @ [[1, 0, 0], [0, 0, -1], [0, 1, 0]]
        middle = np.array([x, y, z])
        for part in ("cam2ego", "ego2global"):
            R, t = poses[part][one["image_id"]]
            turn, middle = R @ turn, R @ middle + t
        tables["sample_annotation"].append(
            {
                **dict.fromkeys(("token", "instance_token"), str(one["id"])),
                "sample_token": one["image_id"],
                "translation": middle.tolist(),
                "rotation": Rotation.from_matrix(turn).as_quat(scalar_first=True).tolist(),
                "size": [width, length, height],
            }
        )
    (source / "v1.0-mini").mkdir(parents=True)
    for table, rows in tables.items():
        (source / f"v1.0-mini/{table}.json").write_text(json.dumps(rows))
    convert(ConvertSettings.of({"data": "nuscenes", "source": source, "out": out}))
    own = _rows(out / f"label_02/{name}.txt")
    order = sorted(stamps, key=stamps.__getitem__)
    found = []
    for one in labels:
        if one["bbox"][3] < 30 or one["category_name"] in ("barrier", "traffic_cone"):
            continue
        x, y, z, _, height, _, yaw_rad = one["bbox_cam3d"]
        rows = own[own[:, 0] == order.index(one["image_id"])]
        distance = np.abs(rows[:, 11:14] - [x, y + height / 2, z]).max(axis=1)
        near = rows[distance.argmin()]
        found.append((distance.min(), np.abs(np.angle(np.exp(1j * (near[14] - yaw_rad))))))
    errors = np.array(found)
    assert len(errors) > 500
    assert np.mean((errors < 1e-3).all(axis=1)) > 0.99


def _posed(token, image, part):
    """A row of nuScenes with a pose."""
    return {
        "token": token,
        "rotation": image[f"{part}_rotation"],
        "translation": image[f"{part}_translation"],
    }
