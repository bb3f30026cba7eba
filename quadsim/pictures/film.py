"""Videos of flights, with the true and the estimated attitude of the vehicle."""

from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import gaussian_filter1d

from ..vehicle import Vehicle
from .render import Scene, View, drawn_by_processor

TRAIL_S = 2.0
"""Length of the trail [s]."""
SMOOTH_S = 0.17
"""Standard deviation of the Gaussian low-pass of the camera's path [s]."""


class Format(NamedTuple):
    """Size and frame rate of a video."""

    width: int  #: [px]
    height: int  #: [px]
    fps: float  #: frames per second

    @classmethod
    def suited(cls) -> "Format":
        """Return the largest format that this computer renders in about real time."""
        return cls(640, 360, 12.5) if drawn_by_processor() else cls(960, 540, 25.0)


class Marks(NamedTuple):
    """Quantities that a video shows in addition to the vehicle, sample by sample."""

    estimate: NDArray[np.float64]  #: (T, 4) estimated quat_WB, of a translucent second body
    target: NDArray[np.float64]  #: (T, 3) set-point [m]
    wind: NDArray[np.float64]  #: (T, 3) wind at the vehicle, world axes [m/s]

    def text(self, k: int, time: float, quat: ArrayLike) -> tuple[str, str]:
        """Return labels and values for sample k: clock, error of the estimate, wind."""
        error = 2 * np.arccos(min(abs(float(np.dot(self.estimate[k], np.asarray(quat)))), 1.0))
        speed = float(np.linalg.norm(self.wind[k]))
        said = {"time": f"{time:.1f} s", "error of estimate (blue)": f"{np.degrees(error):.1f} deg"}
        said |= {"wind (violet)": f"{speed:.1f} m/s", "set-point": "green"}
        return "\n".join(said), "\n".join(said.values())


def film(
    path: str | Path,
    vehicle: Vehicle,
    time: ArrayLike,
    position: ArrayLike,
    quat: ArrayLike,
    marks: Marks,
    progress: Callable[[int, int], object] | None = None,
) -> Path:
    """Write a video of a flight in real time, in which the camera follows the vehicle and its trail.

    Args:
        path: File to write, `.mp4`.
        vehicle: Airframe.
        time: Times of the samples (T,) [s].
        position: Position in world axes (T, 3) [m].
        quat: True quat_WB (T, 4).
        marks: Estimate, set-point and wind, which are shown with a clock.
        progress: Called after each frame with the number of finished frames and the total.

    Raises:
        RuntimeError: Neither EGL nor OSMesa works.
        ValueError: The flight has fewer than two samples.
    """
    import imageio.v2 as imageio

    t, p, q = (np.asarray(each, dtype=np.float64) for each in (time, position, quat))
    if t.ndim != 1 or t.size < 2:
        raise ValueError(f"time has shape {t.shape}; a film needs a flight of at least two samples")
    dt = float(t[1] - t[0])
    width, height, fps = Format.suited()
    frames = np.searchsorted(t, np.arange(t[0], t[-1], 1.0 / fps))
    targets = gaussian_filter1d(p, SMOOTH_S / dt, axis=0, mode="nearest")
    tail = max(round(TRAIL_S / dt), 40)
    with (
        closing(Scene(vehicle, width, height, ghost=True, draft=drawn_by_processor())) as scene,
        imageio.get_writer(path, fps=fps, macro_block_size=2, quality=7) as video,
    ):
        for done, k in enumerate(frames, 1):
            view = View(tuple(targets[k]), distance=2.0, elevation=-18.0)
            trail = p[max(k - tail, 0) : k + 1 : tail // 40]
            shown = marks.target[k], marks.wind[k], marks.text(k, float(t[k]), q[k])
            image = scene.draw(p[k], np.stack([q[k], marks.estimate[k]]), view, trail, *shown)
            video.append_data(image)  # pyright: ignore[reportAttributeAccessIssue]
            if progress is not None:
                progress(done, len(frames))
    return Path(path)
