"""Make the README's picture: python docs/pictures.py [ESTIMATOR]."""

import sys
from pathlib import Path

from PIL import Image

from quadsim.vehicle import load_vehicle
from scenarios.picture import flight_picture
from scenarios.single import fly_scenario

IMAGES = Path(__file__).parent / "img"


def main() -> None:
    """Fly the step scenario and draw the first jump."""
    estimator = sys.argv[1] if len(sys.argv) > 1 else "att-snn-loihi"
    flown = fly_scenario("step", estimator, IMAGES.parent.parent / "reports" / "picture")
    image = flight_picture(flown.results.cells[0], load_vehicle("hummingbird"), 1.9, 4.2, exposures=6)
    IMAGES.mkdir(exist_ok=True)
    Image.fromarray(image).save(IMAGES / "step.jpg", quality=85, optimize=True)


if __name__ == "__main__":
    main()
