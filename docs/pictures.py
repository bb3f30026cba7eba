"""Make the README's picture and the video of the site's first page: `python docs/pictures.py`."""

import subprocess
from pathlib import Path

from imageio_ffmpeg import get_ffmpeg_exe
from pages import ROOT
from PIL import Image

from quadsim.vehicle import load_vehicle
from scenarios.report.flight_picture import flight_picture
from scenarios.single_flight import fly_scenario

ESTIMATOR = "att-snn-loihi"
VIDEO_S = 10.0
WIDTH, QUALITY = 800, 31
"""Width [px], and constant rate factor of H.264."""


def picture(out: Path) -> None:
    """The first jump of the scenario `step`."""
    flown = fly_scenario("step", ESTIMATOR, out / "step")
    image = flight_picture(flown.results.cells[0], load_vehicle("hummingbird"), 1.9, 4.2, exposures=6)
    path = ROOT / "docs" / "img" / "step.jpg"
    Image.fromarray(image).save(path, quality=85, optimize=True)


def video(out: Path) -> None:
    """A figure of eight, small; a browser starts to play it before it has the whole file."""
    changes = {"duration_s": VIDEO_S}
    flown = fly_scenario("figure-8", ESTIMATOR, out / "figure-8", changes=changes, video=True)
    path = ROOT / "docs" / "img" / "flight.mp4"
    coded = ["-c:v", "libx264", "-preset", "slow", "-crf", str(QUALITY), "-pix_fmt", "yuv420p"]
    rest = ["-movflags", "+faststart", "-map_metadata", "-1"]
    command = [get_ffmpeg_exe(), "-v", "error", "-y", "-i", str(flown.video), "-vf", f"scale={WIDTH}:-2"]
    subprocess.run([*command, "-an", *coded, *rest, str(path)], check=True)


if __name__ == "__main__":
    picture(ROOT / "reports")
    video(ROOT / "reports")
