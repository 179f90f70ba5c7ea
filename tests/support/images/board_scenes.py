"""Synthetic views of boards by known cameras: exact corners, and images rendered with lens
distortion and pose."""

from __future__ import annotations

import cv2
import numpy as np

from track_range.stereo.calibration.board_views import BoardView
from track_range.stereo.calibration.boards import Board, CharucoBoard, ChessBoard, charuco_detectors
from track_range.stereo.calibration.one_camera import ViewFit
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rig import StereoRig

CAMERA = PinholeCamera(520.0, 523.0, 315.0, 183.0, 640, 360, (-0.12, 0.05, 0.001, -0.0005, 0.0))
CHESS = ChessBoard(9, 6, 0.03)
_N_SUBPIXELS = 3  # rays per pixel and direction
_TEXEL_M = 0.0005


def rig(*, baseline_m: float = 0.12, roll_deg: float = 0.0) -> StereoRig:
    """Two cameras with different distortion; the right one is rotated slightly, and rolled by
    `roll_deg`."""
    motion = np.eye(4)
    roll = cv2.Rodrigues(np.array([0.0, 0.0, np.radians(roll_deg)]))[0]
    motion[:3, :3] = cv2.Rodrigues(np.array([0.004, -0.02, 0.008]))[0] @ roll
    motion[:3, 3] = motion[:3, :3] @ np.array([-baseline_m, 0.0008, 0.0004])
    right = PinholeCamera(517.0, 519.0, 325.0, 177.0, 640, 360, (-0.10, 0.04, -0.0008, 0.0006, 0.0))
    return StereoRig(CAMERA, right, motion)


def pose(
    rotation_deg: tuple[float, float, float],
    centre_m: tuple[float, float, float],
    board: Board = CHESS,
) -> np.ndarray:
    """(4, 4) board to camera: the board rotated about its centre, which lies at `centre_m`."""
    rotation = cv2.Rodrigues(np.radians(np.array(rotation_deg)))[0]
    centre = (board.corners_m.min(axis=0) + board.corners_m.max(axis=0)) / 2
    board_to_camera = np.eye(4)
    board_to_camera[:3, :3], board_to_camera[:3, 3] = (
        rotation,
        np.array(centre_m) - rotation @ centre,
    )
    return board_to_camera


def varied_poses(n: int, *, seed: int = 0, board: Board = CHESS) -> list[np.ndarray]:
    """Poses in all parts of the image, near and far, with different tilts; visible to both cameras
    of `rig`."""
    rng = np.random.default_rng(seed)
    poses: list[np.ndarray] = []
    while len(poses) < n:
        z = rng.uniform(0.42, 0.8)
        x, y = rng.uniform(-0.5, 0.5) * z, rng.uniform(-0.28, 0.28) * z
        candidate = pose((*rng.uniform(-38, 38, 2), rng.uniform(-15, 15)), (x, y, z), board)
        if all(
            _is_visible(board, camera, from_left @ candidate) for camera, from_left in _cameras()
        ):
            poses.append(candidate)
    return poses


def exact_view(
    camera: PinholeCamera,
    board_to_camera: np.ndarray,
    name: str,
    *,
    board: Board = CHESS,
    noise_px: float = 0.0,
    rng=None,
) -> BoardView:
    """The corners projected by the camera, with noise."""
    zeros = np.zeros((len(board.corners_m), 2))
    ids = np.arange(len(zeros))
    blank = BoardView(name, (camera.width_px, camera.height_px), ids, zeros, board.corners_m, 2.0)
    xy_px = -ViewFit.of(blank, board_to_camera, camera).residual_px
    if noise_px:
        xy_px = xy_px + rng.normal(scale=noise_px, size=xy_px.shape)
    return BoardView(name, blank.size_px, ids, xy_px, board.corners_m, 2.0)


def exact_views(
    n: int, *, noise_px: float = 0.05, seed: int = 0, board: Board = CHESS
) -> list[BoardView]:
    """Views of CAMERA."""
    rng = np.random.default_rng(seed)
    poses = varied_poses(n, seed=seed, board=board)
    return [
        exact_view(CAMERA, pose, f"view{i}", board=board, noise_px=noise_px, rng=rng)
        for i, pose in enumerate(poses)
    ]


def exact_pairs(
    true: StereoRig, n: int, *, noise_px: float = 0.05, seed: int = 0
) -> list[tuple[BoardView, BoardView]]:
    """Pairs of a rig."""
    rng = np.random.default_rng(seed)
    return [
        (
            exact_view(true.left, pose, f"left{i}", noise_px=noise_px, rng=rng),
            exact_view(
                true.right, true.right_from_left @ pose, f"right{i}", noise_px=noise_px, rng=rng
            ),
        )
        for i, pose in enumerate(varied_poses(n, seed=seed))
    ]


def drawn(
    camera: PinholeCamera, board_to_camera: np.ndarray, *, board: Board = CHESS, seed: int = 0
) -> np.ndarray:
    """(H, W) image of the board: each pixel is the mean of 3 x 3 rays through the lens, with slight
    noise."""
    texture, origin_m = _texture(board)
    offsets = (np.arange(_N_SUBPIXELS) + 0.5) / _N_SUBPIXELS - 0.5
    total = np.zeros((camera.height_px, camera.width_px))
    for dy in offsets:
        for dx in offsets:
            total += _one_ray(camera, board_to_camera, texture, origin_m, (dx, dy))
    noise = np.random.default_rng(seed).normal(scale=1.5, size=total.shape)
    return np.clip(total / _N_SUBPIXELS**2 + noise, 0, 255).astype(np.uint8)


_RAYS: dict[tuple, np.ndarray] = {}


def _rays(camera: PinholeCamera, offset: tuple[float, float]) -> np.ndarray:
    """(H W, 1, 2) x/z and y/z of the rays, cached, because undistortion is slow."""
    key = (camera, offset)
    if key not in _RAYS:
        y, x = np.mgrid[0 : camera.height_px, 0 : camera.width_px].astype(np.float64)
        xy = np.stack([x.ravel() + offset[0], y.ravel() + offset[1]], axis=1)[:, None]
        _RAYS[key] = cv2.undistortPoints(
            xy, camera.matrix, np.array(camera.distortion or (0.0,) * 4)
        )
    return _RAYS[key]


def _one_ray(camera, board_to_camera, texture, origin_m, offset) -> np.ndarray:
    texel_from_board = np.array(
        [
            [1 / _TEXEL_M, 0, -origin_m[0] / _TEXEL_M - 0.5],
            [0, 1 / _TEXEL_M, -origin_m[1] / _TEXEL_M - 0.5],
            [0, 0, 1],
        ]
    )
    # the board is the plane z = 0
    homography = texel_from_board @ np.linalg.inv(board_to_camera[:3, [0, 1, 3]])
    texel = cv2.perspectiveTransform(_rays(camera, offset), homography)
    texel = texel.astype(np.float32).reshape(camera.height_px, camera.width_px, 2)
    return cv2.remap(
        texture,
        texel[..., 0],
        texel[..., 1],
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=128.0,
    ).astype(np.float64)


def _texture(board: Board) -> tuple[np.ndarray, np.ndarray]:
    """Texture of the printed board with a white margin, and the position of the corner of its first
    texel."""
    square = round(board.square_m / _TEXEL_M)
    if isinstance(board, CharucoBoard):
        size = (board.n_columns * square, board.n_rows * square)
        image = charuco_detectors(board)[0].getBoard().generateImage(size, marginSize=0)
        first_m = 0.0
    else:
        rows, columns = np.mgrid[0 : board.n_rows + 1, 0 : board.n_columns + 1]
        image = np.kron(np.where((rows + columns) % 2, 30, 225), np.ones((square, square)))
        first_m = -board.square_m
    texture = cv2.copyMakeBorder(
        image.astype(np.float32), *[square] * 4, cv2.BORDER_CONSTANT, value=225.0
    )
    return texture, np.full(2, first_m - board.square_m)


def _cameras():
    true = rig()
    return (true.left, np.eye(4)), (true.right, true.right_from_left)


def _is_visible(board: Board, camera: PinholeCamera, board_to_camera: np.ndarray) -> bool:
    xy = exact_view(camera, board_to_camera, "", board=board).xy_px
    return bool((xy > 12).all() and (xy < np.array([camera.width_px, camera.height_px]) - 12).all())
