"""Make the README's animation, and the video and its first picture on the site: `python docs/pictures.py`."""

import subprocess
from contextlib import closing
from pathlib import Path

import numpy as np
import pandas as pd
from imageio_ffmpeg import get_ffmpeg_exe
from pages import ROOT
from PIL import Image

from quadsim.pictures.render import Scene, View
from quadsim.rotation import quat_from_euler
from quadsim.vehicle import load_vehicle
from scenarios.single_flight import fly_scenario

ESTIMATOR = "att-snn-loihi"
VEHICLE = "hummingbird"
SHOWN_S = 1.9, 4.2
VIDEO_S = 10.0
WIDTH, QUALITY = 800, 31
"""Width [px], and constant rate factor of H.264."""


def exposures(samples: Path, start_s: float, end_s: float, count: int = 6) -> Image.Image:
    """A part of a flight with as many exposures, evenly spaced along the path."""
    part = pd.read_csv(samples).query("@start_s <= t <= @end_s")
    place = part[["x", "y", "z"]].to_numpy()
    quat = quat_from_euler(*part[["roll", "pitch", "yaw"]].to_numpy().T)
    path = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(place, axis=0), axis=1))])
    shown = np.unique(np.searchsorted(path, np.linspace(0.0, path[-1], count)).clip(max=len(path) - 1))
    low, high = place.min(axis=0), place.max(axis=0)
    along = np.degrees(np.arctan2(*(place[-1] - place[0])[1::-1]))
    far = 0.8 + 0.95 * float(np.linalg.norm(high - low))
    view = View(tuple(0.5 * (low + high)), far, azimuth=along + 70.0, elevation=-12.0)
    with closing(Scene(load_vehicle(VEHICLE), len(shown), 2400, 1350)) as scene:
        image = Image.fromarray(scene.draw(place[shown], quat[shown], view, place))
    return image.resize((1200, 675), Image.Resampling.BOX)  # smooth edges, also without multisampling


def picture(out: Path) -> None:
    """The first jump of the scenario `step`."""
    flown = fly_scenario("step", ESTIMATOR, out / "step")
    image = exposures(flown.samples, *SHOWN_S)
    image.save(ROOT / "docs" / "img" / "step.jpg", quality=85, optimize=True)


def video(out: Path) -> None:
    """A figure of eight, small; a browser starts to play it before it has the whole file."""
    changes = {"duration_s": VIDEO_S}
    flown = fly_scenario("figure-8", ESTIMATOR, out / "figure-8", changes=changes, video=True)
    images = ROOT / "docs" / "img"
    coded = ["-c:v", "libx264", "-preset", "slow", "-crf", str(QUALITY), "-pix_fmt", "yuv420p"]
    rest = ["-movflags", "+faststart", "-map_metadata", "-1"]
    run_ffmpeg("-i", flown.video, "-vf", f"scale={WIDTH}:-2", "-an", *coded, *rest, images / "flight.mp4")
    small = ["-vf", "fps=12,scale=720:-2", "-c:v", "libwebp_anim", "-quality", 55, "-loop", 0]
    run_ffmpeg("-ss", 1, "-t", 4, "-i", images / "flight.mp4", *small, images / "flight.webp")


def run_ffmpeg(*arguments: object) -> None:
    """Run the bundled ffmpeg, which overwrites its output."""
    subprocess.run([get_ffmpeg_exe(), "-v", "error", "-y", *map(str, arguments)], check=True)


if __name__ == "__main__":
    picture(ROOT / "reports")
    video(ROOT / "reports")
