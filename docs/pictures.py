"""Make the README's animation, and the site's video with its first picture: `python docs/pictures.py`."""

import subprocess
from pathlib import Path

from imageio_ffmpeg import get_ffmpeg_exe
from pages import ROOT

from scenarios.single_flight import fly_scenario

ESTIMATOR = "att-snn-loihi"
VIDEO_S = 10.0
WIDTH, QUALITY = 800, 31
"""Width [px], and constant rate factor of H.264."""


def video(out: Path) -> None:
    """A figure of eight, small; a browser starts to play it before it has the whole file."""
    changes = {"duration_s": VIDEO_S}
    flown = fly_scenario("figure-8", ESTIMATOR, out / "figure-8", changes=changes, video=True)
    small = ROOT / "docs" / "img" / "flight.mp4"
    coded = ["-c:v", "libx264", "-preset", "slow", "-crf", str(QUALITY), "-pix_fmt", "yuv420p"]
    rest = ["-movflags", "+faststart", "-map_metadata", "-1"]
    run_ffmpeg("-i", flown.video, "-vf", f"scale={WIDTH}:-2", "-an", *coded, *rest, small)
    run_ffmpeg("-ss", 2, "-i", small, "-frames:v", 1, "-q:v", 4, small.with_suffix(".jpg"))
    looped = ["-vf", "fps=12,scale=720:-2", "-c:v", "libwebp_anim", "-quality", 55, "-loop", 0]
    run_ffmpeg("-ss", 1, "-t", 4, "-i", small, *looped, small.with_suffix(".webp"))


def run_ffmpeg(*arguments: object) -> None:
    """Run the bundled ffmpeg, which overwrites its output."""
    subprocess.run([get_ffmpeg_exe(), "-v", "error", "-y", *map(str, arguments)], check=True)


if __name__ == "__main__":
    video(ROOT / "reports")
