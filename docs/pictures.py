"""Make the README's picture: python docs/pictures.py [ESTIMATOR]."""

import sys

from pages import load_page
from PIL import Image

from quadsim.vehicle import load_vehicle
from scenarios.report.flight_picture import flight_picture
from scenarios.single_flight import fly_scenario


def main() -> None:
    """Fly the step scenario and draw the first jump."""
    page = load_page("picture")
    estimator = sys.argv[1] if len(sys.argv) > 1 else "att-snn-loihi"
    flown = fly_scenario("step", estimator, page.root / "reports" / "picture")
    image = flight_picture(flown.results.cells[0], load_vehicle("hummingbird"), 1.9, 4.2, exposures=6)
    path = page.root / "docs" / "img" / "step.jpg"
    Image.fromarray(image).save(path, quality=85, optimize=True, comment=page.stamp)
    page.note()


if __name__ == "__main__":
    main()
