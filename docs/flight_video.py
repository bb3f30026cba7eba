"""Make the video of the site's first page: `python docs/flight_video.py`.

It is the video of `quadsim fly figure-8 --estimator att-snn-loihi --duration 10 --video`, compressed.
"""

import subprocess
from pathlib import Path

from imageio_ffmpeg import get_ffmpeg_exe
from pages import load_page

from scenarios.bench.settings import ScenarioChanges
from scenarios.single_flight import fly_scenario

SCENARIO, ESTIMATOR, DURATION_S = "figure-8", "att-snn-loihi", 10.0
WIDTH, QUALITY = 800, 31
"""Width [px], and constant rate factor of H.264."""


def compress(source: Path, path: Path, comment: str) -> None:
    """Write a small video that a browser starts to play before it has the whole."""
    coded = ["-c:v", "libx264", "-preset", "slow", "-crf", str(QUALITY), "-pix_fmt", "yuv420p"]
    rest = ["-movflags", "+faststart", "-map_metadata", "-1", "-metadata", f"comment={comment}"]
    command = [get_ffmpeg_exe(), "-v", "error", "-y", "-i", str(source), "-vf", f"scale={WIDTH}:-2", "-an"]
    subprocess.run([*command, *coded, *rest, str(path)], check=True)


def main() -> None:
    """Fly, draw, and compress."""
    page = load_page("flight-video")
    out, changes = page.root / "reports" / "flight-video", ScenarioChanges(duration_s=DURATION_S)
    flown = fly_scenario(SCENARIO, ESTIMATOR, out, changes=changes, video=True)
    assert flown.video is not None
    compress(flown.video, page.root / "docs" / "img" / "flight.mp4", page.stamp)
    page.note()


if __name__ == "__main__":
    main()
