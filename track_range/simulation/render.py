r"""One eye's image of a scene: textured faces under exact perspective, hidden surfaces removed by a depth buffer.

A face is C + s U + t V in the camera's frame. With the texture's texel (i, j) at s = (i + 1/2) / n, its pixel is
    (u w, v w, w)^T = K [U V C] (s, t, 1)^T                   a homography: cv2.warpPerspective draws it exactly
and on its plane n . P = d, n = U x V, the inverse depth is affine in the pixel, 1/z = n . (x, y, 1)^T / d: that is what
the depth buffer holds. Against aliasing, which would move a texture against its surface: everything is drawn with
2 x 2 samples per pixel, textures are first averaged down (area) to the samples they will cover, and faces that reach
far along the view are cut into pieces of nearly equal depth, each averaged for its own.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

import cv2
import numpy as np

from detection.detections import FloatArray, Image
from stereo.camera import PinholeCamera
from stereo.rig import StereoRig
from track_range.simulation.bodies import body_of
from track_range.simulation.faces import Face
from track_range.simulation.scene import Scene
from track_range.simulation.street import FAR_M, Street
from track_range.simulation.textures import TEXELS_PER_M, sky_picture

Eye = Literal["left", "right"]

SAMPLES = 2
"""Per pixel and axis."""

NEAR_M = 0.3
DEPTH_RATIO = 1.4
"""A face reaching farther than this between nearest and farthest corner is cut in two, up to `CUTS` times."""

CUTS = 6
N_HALVINGS = 3
LONGEST_HALF_M = 8.0
"""No body reaches farther than this towards the camera from its centre."""

LENS_BLUR_SAMPLES = 0.8
"""Standard deviation of the lens's blur, about 0.4 px; a lens without any would show detail finer than its pixels."""

NOISE_GREY = 2.0
"""Standard deviation of the sensor's noise, grey levels."""

HALF_SEEN = 112
"""Alpha from which a sample counts as hit; a little below half, so that no gap opens between pieces of one face."""


def kitti_like_rig(*, width_px: int = 1240, height_px: int = 376, baseline_m: float = 0.54) -> StereoRig:
    """A rectified pair with KITTI's angle of view, for any image size: fx = 721.5 px at 1240 px."""
    focal_px = 721.5 * width_px / 1240
    camera = PinholeCamera(focal_px, focal_px, 0.492 * width_px, 0.46 * height_px, width_px, height_px)
    return StereoRig.rectified(camera, baseline_m)


class Renderer:
    """Draws a scene for either eye at any time; textures are made once, and the scene is never changed.

    Args:
        scene: what there is to see.
        rig: a rectified pair; the left eye is the scene's camera.
        noise_grey: standard deviation of the sensor noise in grey levels, 0 = none.
    """

    def __init__(self, scene: Scene, rig: StereoRig, *, noise_grey: float = NOISE_GREY) -> None:
        if not rig.is_rectified:
            raise ValueError("the simulation draws rectified pairs: equal, parallel, undistorted cameras wanted")
        self.scene = scene
        self.rig = rig
        self.noise_grey = noise_grey
        rng = np.random.default_rng([scene.seed, 3])
        self._bodies = [_by_distance(body_of(user, scene.seed)) for user in scene.road_users]
        self._street = Street(rng)
        self._camera = _finer(rig.left)
        self._sky = sky_picture(
            rng, width_px=self._camera.width_px, height_px=self._camera.height_px, horizon_px=self._camera.cy_px
        )

    def render(self, time_s: float, *, eye: Eye = "left") -> Image:
        """(H, W, 3) uint8 BGR; the same scene, time and eye give the same pixels."""
        lens = cv2.GaussianBlur(self._drawn(time_s, eye).bgra, (3, 3), LENS_BLUR_SAMPLES)
        image = cv2.resize(lens, self._size_px, interpolation=cv2.INTER_AREA)[:, :, :3]
        return self._with_noise(np.asarray(image, np.uint8), time_s, eye)

    def depth_m(self, time_s: float, *, eye: Eye = "left") -> FloatArray:
        """(H, W) exact z of what each pixel shows, the mean in 1/z over its samples; NaN = sky."""
        inverse = cv2.resize(self._drawn(time_s, eye).inverse_depth, self._size_px, interpolation=cv2.INTER_AREA)
        return np.asarray(1.0 / np.where(inverse > 0, inverse, np.nan), np.float64)

    @property
    def _size_px(self) -> tuple[int, int]:
        return self.rig.left.width_px, self.rig.left.height_px

    def _drawn(self, time_s: float, eye: Eye) -> Canvas:
        canvas = Canvas(self._camera, self._sky)
        shift_m = np.array([-self.rig.baseline_m if eye == "right" else 0.0, 0.0, 0.0])
        down_m = np.array([0.0, self.scene.camera_height_m, 0.0])
        for face in self._street.faces(self.scene.ego_z_m(time_s)):
            canvas.draw(face, down_m + shift_m)
        rotation = self.scene.rotation_y_rad()
        for bodies, location_m, yaw_rad in zip(self._bodies, self.scene.location_m(time_s), rotation, strict=True):
            if -LONGEST_HALF_M < location_m[2] < FAR_M:
                for face in bodies[self._coarseness(float(location_m[2]))]:
                    canvas.draw(_turned(face, float(yaw_rad)), location_m + shift_m)
        return canvas

    def _coarseness(self, z_m: float) -> int:
        """How often the textures of a body at that depth may be halved and still have a texel per sample."""
        texels_per_sample = TEXELS_PER_M * max(z_m - LONGEST_HALF_M, NEAR_M) / self._camera.fx_px
        return int(np.clip(np.log2(texels_per_sample), 0, N_HALVINGS))

    def _with_noise(self, image: Image, time_s: float, eye: Eye) -> Image:
        if self.noise_grey <= 0:
            return image
        stream = [self.scene.seed, 4, round(time_s * 1e6), int(eye == "right")]
        noise = np.random.default_rng(stream).standard_normal(image.shape, np.float32)
        noisy = cv2.scaleAdd(noise, self.noise_grey, image.astype(np.float32))
        return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def render(scene: Scene, time_s: float, *, rig: StereoRig, eye: Eye = "left") -> Image:
    """(H, W, 3) uint8 BGR image of one eye; for more than one, a `Renderer` makes the textures only once."""
    return Renderer(scene, rig).render(time_s, eye=eye)


class Canvas:
    """A picture being drawn, with a depth buffer: (H, W, 4) `bgra` and (H, W) `inverse_depth`, 1/m, 0 = sky."""

    def __init__(self, camera: PinholeCamera, background: Image) -> None:
        self.camera = camera
        self.bgra = background.copy()
        self.inverse_depth = np.zeros(background.shape[:2], np.float32)
        self._ray_of_pixel = np.linalg.inv(camera.matrix)
        self._colours = self.bgra.view(np.uint32)[:, :, 0]  # one number per sample: quicker to copy under a mask

    def draw(self, face: Face, shift_m: FloatArray, *, cuts: int = CUTS) -> None:
        """Draw a face, moved by `shift_m`, where nothing nearer stands; what lies before `NEAR_M` is left out."""
        corner = face.corner + shift_m
        normal = _cross(face.along, face.down)
        if not face.two_sided and normal @ corner <= 0:
            return
        corners = corner + np.array([np.zeros(3), face.along, face.along + face.down, face.down])
        near_m, far_m = corners[:, 2].min(), corners[:, 2].max()
        if far_m < NEAR_M:
            return
        if cuts and far_m > DEPTH_RATIO * max(near_m, NEAR_M) and min(face.texture.shape[:2]) > 1:
            for half in _halves(face):
                self.draw(half, shift_m, cuts=cuts - 1)
        elif near_m >= NEAR_M:
            self._draw_piece(face, corner, corners, normal)

    def _draw_piece(self, face: Face, corner: FloatArray, corners: FloatArray, normal: FloatArray) -> None:
        """Warp one piece, all of it in front of the camera, into the box that it covers."""
        at_px = self.camera.project(corners)
        left, top = np.maximum(np.floor(at_px.min(axis=0)), 0).astype(int).tolist()
        last_px = (self.camera.width_px - 1, self.camera.height_px - 1)
        right, bottom = np.minimum(np.ceil(at_px.max(axis=0)), last_px).astype(int).tolist()
        if left > right or top > bottom:
            return
        texture = _averaged(face.texture, at_px)
        texel = np.diag([1 / (texture.shape[1] - 2), 1 / (texture.shape[0] - 2), 1.0])  # two texels are margin
        texel[:2, 2] = -0.5 * texel[0, 0], -0.5 * texel[1, 1]
        to_roi = np.array([[1.0, 0.0, -left], [0.0, 1.0, -top], [0.0, 0.0, 1.0]])
        homography = to_roi @ self.camera.matrix @ np.stack([face.along, face.down, corner], axis=1) @ texel
        size_px = (right - left + 1, bottom - top + 1)
        warped = cv2.warpPerspective(texture, homography, size_px, flags=cv2.INTER_LINEAR)
        inverse = normal @ self._ray_of_pixel / (normal @ corner)
        rows = (np.arange(top, bottom + 1) * inverse[1] + inverse[2]).astype(np.float32)
        inverse_depth = rows[:, None] + (np.arange(left, right + 1) * inverse[0]).astype(np.float32)
        window = np.s_[top : bottom + 1, left : right + 1]
        hit = (warped[:, :, 3] >= HALF_SEEN) & (inverse_depth > self.inverse_depth[window])
        np.copyto(self.inverse_depth[window], inverse_depth, where=hit)
        np.copyto(self._colours[window], warped.view(np.uint32)[:, :, 0], where=hit)


def _finer(camera: PinholeCamera) -> PinholeCamera:
    """The camera whose pixels are the samples: sample k of pixel u lies at u + (k + 1/2) / SAMPLES - 1/2."""
    return PinholeCamera(
        camera.fx_px * SAMPLES,
        camera.fy_px * SAMPLES,
        (camera.cx_px + 0.5) * SAMPLES - 0.5,
        (camera.cy_px + 0.5) * SAMPLES - 0.5,
        camera.width_px * SAMPLES,
        camera.height_px * SAMPLES,
    )


def _averaged(texture: Image, at_px: FloatArray) -> Image:
    """The texture brought down to the samples that its edges cover, with a transparent margin of one texel.

    The margin repeats the colours of the edge, so that only alpha fades out.
    """
    sides_px = np.linalg.norm(at_px[[1, 2, 3, 0]] - at_px, axis=1)  # top, right, bottom, left
    wanted = np.ceil([max(sides_px[0], sides_px[2]), max(sides_px[1], sides_px[3])]).astype(int)
    width, height = np.clip(wanted, 1, (texture.shape[1], texture.shape[0])).tolist()
    small = texture
    if (height, width) != texture.shape[:2]:
        small = np.asarray(cv2.resize(texture, (width, height), interpolation=cv2.INTER_AREA), np.uint8)
    framed = cv2.copyMakeBorder(small, 1, 1, 1, 1, cv2.BORDER_REPLICATE)
    framed[[0, -1], :, 3] = 0
    framed[:, [0, -1], 3] = 0
    return np.asarray(framed, np.uint8)


def _halves(face: Face) -> Iterator[Face]:
    """A face cut in two across the edge that reaches farther in depth, at a whole texel."""
    axis = 1 if abs(face.along[2]) >= abs(face.down[2]) else 0
    n_texels = face.texture.shape[axis]
    share = (n_texels // 2) / n_texels
    along, down, two_sided = face.along, face.down, face.two_sided
    first, second = np.split(face.texture, [n_texels // 2], axis=axis)
    if axis == 1:
        yield Face(face.corner, along * share, down, first, two_sided)
        yield Face(face.corner + along * share, along * (1 - share), down, second, two_sided)
    else:
        yield Face(face.corner, along, down * share, first, two_sided)
        yield Face(face.corner + down * share, along, down * (1 - share), second, two_sided)


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """The cross product of two vectors (np.cross takes ten times as long for one)."""
    return a[[1, 2, 0]] * b[[2, 0, 1]] - a[[2, 0, 1]] * b[[1, 2, 0]]


def _by_distance(body: list[Face]) -> list[list[Face]]:
    """The body, then the same with textures of half, a quarter ... of the texels per metre, for greater distances."""
    bodies = [body]
    for _ in range(N_HALVINGS):
        bodies.append([_halved(face) for face in bodies[-1]])
    return bodies


def _halved(face: Face) -> Face:
    size_px = (max(1, face.texture.shape[1] // 2), max(1, face.texture.shape[0] // 2))
    texture = np.asarray(cv2.resize(face.texture, size_px, interpolation=cv2.INTER_AREA), np.uint8)
    return Face(face.corner, face.along, face.down, texture, face.two_sided)


def _turned(face: Face, yaw_rad: float) -> Face:
    """From a road user's own axes to the camera's (KITTI's rotation_y)."""
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    turn = np.array([[cos, 0.0, sin], [0.0, 1.0, 0.0], [-sin, 0.0, cos]])
    return Face(turn @ face.corner, turn @ face.along, turn @ face.down, face.texture, face.two_sided)
