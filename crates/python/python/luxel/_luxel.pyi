"""Types of the native module; its documentation is in its docstrings."""

from os import PathLike
from typing import Any, Callable, Iterator, Sequence, Union

import numpy as np
from numpy.typing import ArrayLike, NDArray

_Path = Union[str, PathLike[str]]
_F32 = NDArray[np.float32]
_F64 = NDArray[np.float64]
_U32 = NDArray[np.uint32]
_Report = Callable[[int, int, str], Any]

__version__: str

class LuxelError(Exception):
    remedy: str | None

class Camera:
    def __init__(
        self,
        camera_from_world: ArrayLike,
        K: ArrayLike,
        width: int,
        height: int,
        *,
        projection: str = "pinhole",
        fisheye: Sequence[float] | None = None,
        max_angle: float | None = None,
        distortion: Sequence[float] | None = None,
    ) -> None: ...
    @staticmethod
    def from_opencv(camera_from_world: ArrayLike, K: ArrayLike, width: int, height: int) -> Camera: ...
    @staticmethod
    def from_opengl(world_from_camera: ArrayLike, K: ArrayLike, width: int, height: int) -> Camera: ...
    @staticmethod
    def from_colmap(
        model: str, params: Sequence[float], width: int, height: int, qvec: Sequence[float], tvec: Sequence[float]
    ) -> Camera: ...
    @staticmethod
    def from_nerfstudio(frame: dict[str, Any], shared: dict[str, Any] | None = None) -> Camera: ...
    @staticmethod
    def panorama(camera_from_world: ArrayLike, width: int) -> Camera: ...
    @staticmethod
    def look_at(
        eye: Sequence[float], target: Sequence[float], up: Sequence[float], fov: float, width: int, height: int
    ) -> Camera: ...
    @property
    def camera_from_world(self) -> _F64: ...
    @property
    def world_from_camera(self) -> _F64: ...
    @property
    def K(self) -> _F64: ...
    @property
    def width(self) -> int: ...
    @property
    def height(self) -> int: ...
    @property
    def position(self) -> _F64: ...
    @property
    def forward(self) -> _F64: ...
    @property
    def projection(self) -> str: ...
    @property
    def fisheye(self) -> list[float] | None: ...
    @property
    def max_angle(self) -> float | None: ...
    @property
    def distortion(self) -> list[float]: ...
    def to_opencv(self) -> tuple[_F64, _F64]: ...
    def to_opengl(self) -> _F64: ...
    def to_colmap(self) -> dict[str, Any]: ...
    def to_nerfstudio(self, file_path: str = "camera") -> dict[str, Any]: ...
    def project(self, points: ArrayLike) -> tuple[_F64, _F64]: ...
    def directions(self, pixels: ArrayLike) -> _F64: ...
    def downscaled(self, factor: int) -> Camera: ...
    def moved_to(self, camera_from_world: ArrayLike) -> Camera: ...

class View:
    @property
    def name(self) -> str: ...
    @property
    def camera(self) -> Camera: ...
    @property
    def image(self) -> _F32: ...
    @property
    def mask(self) -> _F32 | None: ...
    @property
    def exposure(self) -> float | None: ...

class Dataset:
    @staticmethod
    def open(
        path: _Path,
        *,
        image_memory: str | None = None,
        cache: _Path | None = None,
        progress: _Report | None = None,
        **options: Any,
    ) -> Dataset: ...
    @staticmethod
    def from_arrays(
        images: Sequence[ArrayLike],
        cameras: Sequence[Camera],
        *,
        masks: Sequence[ArrayLike | None] | None = None,
        test: Sequence[int] | None = None,
        names: Sequence[str] | None = None,
        points: ArrayLike | None = None,
        point_colors: ArrayLike | None = None,
        color_space: str = "linear-rec709",
    ) -> Dataset: ...
    @property
    def train(self) -> list[View]: ...
    @property
    def test(self) -> list[View]: ...
    @property
    def points(self) -> _F64: ...
    @property
    def point_colors(self) -> NDArray[np.uint8]: ...
    @property
    def color_space(self) -> str: ...
    @property
    def metres_per_unit(self) -> float | None: ...
    @property
    def format(self) -> str: ...
    @property
    def warnings(self) -> list[str]: ...
    @property
    def fingerprint(self) -> str: ...
    @property
    def world_from_local(self) -> _F64: ...

class Scene:
    positions: _F32
    rotations: _F32
    log_scales: _F32
    opacity_logits: _F32
    sh: _F32
    raw_luminance: _F32
    smoothing: _F32
    gain: _F32
    background: list[float]
    @staticmethod
    def open(path: _Path) -> Scene: ...
    @staticmethod
    def from_arrays(
        positions: ArrayLike,
        rotations: ArrayLike,
        log_scales: ArrayLike,
        opacity_logits: ArrayLike,
        sh: ArrayLike,
        raw_luminance: ArrayLike | None = None,
        *,
        color_model: str = "sh3",
        radiance_scale: float = 1.0,
        color_space: str = "linear-rec709",
    ) -> Scene: ...
    def save(self, path: _Path) -> None: ...
    def copy(self) -> Scene: ...
    def set(self, **arrays: ArrayLike) -> None: ...
    def fold_gains(self) -> None: ...
    def render(
        self,
        camera: Camera,
        *,
        background: Sequence[float] | None = None,
        samples: int | None = None,
        device: str = "auto",
        threads: int | None = None,
    ) -> _F32: ...
    def photograph(
        self,
        camera: Camera,
        *,
        aperture: float | None = None,
        focus: float | None = None,
        blades: int | None = None,
        before: Camera | None = None,
        after: Camera | None = None,
        shutter: float = 180.0,
        lens_samples: int | None = None,
        sample_set: int = 0,
        background: Sequence[float] | None = None,
        samples: int | None = None,
        device: str = "auto",
        threads: int | None = None,
    ) -> _F32: ...
    def render_layers(
        self,
        camera: Camera,
        *,
        background: Sequence[float] | None = None,
        samples: int | None = None,
        threads: int | None = None,
    ) -> dict[str, _F32]: ...
    def render_normals(
        self,
        camera: Camera,
        *,
        samples: int | None = None,
        threads: int | None = None,
    ) -> _F32: ...
    def edit(self, edit: str) -> int: ...
    def export(
        self,
        path: _Path,
        *,
        bake: str | None = None,
        color_space: str | None = None,
        tonemap: str | None = None,
        exposure: float = 0.0,
        max_degree: int = 3,
        max_splats: int | None = None,
        dataset: Dataset | None = None,
        origin: Sequence[float] | None = None,
        rotation: ArrayLike | None = None,
        scale: float = 1.0,
        metres_per_unit: float | None = None,
        lights: bool = False,
        device: str = "auto",
    ) -> dict[str, Any]: ...
    def probe(
        self,
        at: Sequence[float],
        *,
        width: int = 2048,
        projection: str = "latlong",
        near: float | None = None,
        up: Sequence[float] | None = None,
        color_space: str | None = None,
        background: Sequence[float] | None = None,
        alpha: bool = False,
        dataset: Dataset | None = None,
        device: str = "auto",
    ) -> Probe: ...
    def lights(
        self,
        dataset: Dataset,
        *,
        medians: float = 100.0,
        windows: float | None = 30.0,
        portals: bool = False,
        most: int = 32,
        map: bool = True,
        at: Sequence[float] | None = None,
        width: int = 1024,
        fill: bool = True,
        up: Sequence[float] | None = None,
        color_space: str = "linear-rec709",
        device: str = "auto",
    ) -> Lights: ...
    def mesh(
        self,
        dataset: Dataset | None = None,
        *,
        cameras: Sequence[Camera] | None = None,
        voxel: float | None = None,
        triangles: int | None = None,
        min_island: float | None = None,
        max_hole: float | None = None,
        max_depth: float | None = None,
        image_size: int = 400,
        max_views: int = 200,
        up: Sequence[float] | None = None,
        color_space: str | None = None,
    ) -> Mesh: ...
    @property
    def color_model(self) -> str: ...
    @property
    def separates_luminance(self) -> bool: ...
    @property
    def metres_per_unit(self) -> float | None: ...
    @property
    def radiance_scale(self) -> float: ...
    @property
    def color_space(self) -> str: ...
    @property
    def edits(self) -> list[str]: ...
    @property
    def world_from_local(self) -> _F64: ...
    @property
    def raster(self) -> dict[str, Any]: ...
    def __len__(self) -> int: ...

class Lights:
    @property
    def lamps(self) -> list[dict[str, Any]]: ...
    @property
    def map(self) -> Probe | None: ...
    @property
    def unseen_share(self) -> float: ...
    @property
    def left_in_map(self) -> list[str]: ...
    @property
    def color_space(self) -> str: ...
    def save(self, path: _Path) -> None: ...
    def __len__(self) -> int: ...

class Mesh:
    @property
    def positions(self) -> _F32: ...
    @property
    def normals(self) -> _F32: ...
    @property
    def radiance(self) -> _F32: ...
    @property
    def triangles(self) -> _U32: ...
    @property
    def voxel(self) -> float: ...
    @property
    def color_space(self) -> str: ...
    def save(self, path: _Path) -> None: ...

class Probe:
    @property
    def image(self) -> _F32: ...
    @property
    def alpha(self) -> _F32 | None: ...
    @property
    def map_from_world(self) -> _F64: ...
    @property
    def lights(self) -> list[dict[str, Any]]: ...
    @property
    def peak_radiance(self) -> float: ...
    @property
    def color_space(self) -> str: ...
    def save_exr(self, path: _Path, *, exr_type: str = "auto") -> None: ...

class Progress:
    @property
    def number(self) -> int: ...
    @property
    def total(self) -> int: ...
    @property
    def loss(self) -> float: ...
    @property
    def splats(self) -> int: ...
    @property
    def visible(self) -> int: ...

class Training:
    def __init__(
        self,
        dataset: Dataset,
        *,
        preset: str | None = None,
        steps: int | None = None,
        device: str = "auto",
        threads: int | None = None,
        resume: _Path | None = None,
        **options: Any,
    ) -> None: ...
    def __iter__(self) -> Iterator[Progress]: ...
    def __next__(self) -> Progress: ...
    def step(self) -> Progress: ...
    def evaluate(self, views: str | Sequence[View] | None = None) -> dict[str, Any]: ...
    def render(self, camera: Camera) -> _F32: ...
    def scene(self) -> Scene: ...
    def checkpoint(self, path: _Path) -> None: ...
    @property
    def steps_made(self) -> int: ...
    @property
    def is_finished(self) -> bool: ...
    @property
    def options(self) -> dict[str, Any]: ...
    @property
    def cameras(self) -> list[Camera]: ...

def read_cameras(
    path: _Path,
    *,
    width: int | None = None,
    height: int | None = None,
    camera: str | None = None,
    dataset: Dataset | None = None,
    metres_per_unit: float | None = None,
) -> dict[str, Camera]: ...
def write_cameras(
    path: _Path,
    cameras: dict[str, Camera],
    *,
    moving: bool = False,
    fps: float = 24.0,
    dataset: Dataset | None = None,
    metres_per_unit: float | None = None,
) -> None: ...
def read_image(
    path: _Path, *, transfer: str | None = None, layer: str | None = None, color_space: str | None = None
) -> tuple[_F32, str | None]: ...
def write_exr(
    path: _Path,
    image: ArrayLike,
    *,
    color_space: str = "linear-rec709",
    exr_type: str = "auto",
    alpha: ArrayLike | None = None,
    depth: ArrayLike | None = None,
    camera: Camera | None = None,
    attributes: dict[str, str | float] | None = None,
) -> None: ...
def write_preview(
    path: _Path,
    image: ArrayLike,
    *,
    tonemap: str = "agx",
    exposure: float = 0.0,
    white: float = 1.0,
    color_space: str = "linear-rec709",
) -> None: ...
def convert_color_space(image: ArrayLike, source: str, target: str) -> _F32: ...
def compare(
    reference: ArrayLike,
    image: ArrayLike,
    *,
    mask: ArrayLike | None = None,
    scale: float | None = None,
    mu: float | None = None,
    peak_luminance: float | None = None,
    hdr_flip: bool = True,
    lpips_weights: _Path | None = None,
    color_space: str = "linear-rec709",
) -> dict[str, Any]: ...
def compare_files(
    reference: _Path,
    test: _Path,
    *,
    scale: float | None = None,
    mu: float | None = None,
    peak_luminance: float | None = None,
    hdr_flip: bool = True,
    lpips_weights: _Path | None = None,
    mask: _Path | None = None,
    transfer: str | None = None,
    color_space: str | None = None,
) -> dict[str, Any]: ...
def training_options(preset: str | None = None) -> dict[str, Any]: ...
def run_command(args: Sequence[_Path]) -> int: ...
def main(args: Sequence[_Path]) -> int: ...

def spatial_order(positions: _F32) -> NDArray[np.int64]: ...

_ColorModel = tuple[int, int | None, str | None]

class Rasterizer:
    """Rasterises splats with gradients on the threads of the processor."""

    def __new__(cls, threads: int = 0) -> Rasterizer: ...
    def project(
        self,
        means: _F32,
        quats: _F32,
        scales: _F32,
        opacities: _F32,
        viewmats: _F32,
        ks: _F32,
        width: int,
        height: int,
        *,
        near_plane: float = 0.01,
        far_plane: float = 1e10,
        radius_clip: float = 0.0,
        eps2d: float = 0.3,
        antialiased: bool = False,
        packed: bool = False,
    ) -> tuple[Projection, dict[str, NDArray[Any]]]: ...
    def colors(
        self,
        means: _F32,
        eyes: _F32,
        sh: _F32,
        raw_luminance: _F32,
        visible: NDArray[np.bool_] | None,
        model: _ColorModel,
        active_degree: int,
    ) -> _F32: ...
    def colors_backward(
        self,
        means: _F32,
        eyes: _F32,
        sh: _F32,
        raw_luminance: _F32,
        visible: NDArray[np.bool_] | None,
        model: _ColorModel,
        active_degree: int,
        gradient: _F32,
    ) -> list[_F32]: ...

class Projection:
    """Splats on the screens of cameras."""

    def blend(self, channels: _F32, background: _F32 | None = None) -> tuple[Blending, _F32, _F32]: ...
    def backward(
        self,
        means2d: _F32 | None = None,
        covars2d: _F32 | None = None,
        conics: _F32 | None = None,
        depths: _F32 | None = None,
        opacities: _F32 | None = None,
        *,
        by_covariance: bool = False,
        by_viewmats: bool = True,
    ) -> list[_F32 | None]: ...

class Blending:
    """Blended images."""

    def backward(self, images: _F32, alpha: _F32 | None = None, *, absolute: bool = False) -> dict[str, _F32]: ...
