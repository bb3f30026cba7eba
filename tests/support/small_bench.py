"""A benchmark that takes a moment."""

from scenarios.bench.cell import FlightSettings
from scenarios.bench.runner import bench

SHORT = 0.3


def small(out, scenarios=("hover", "wind-gust"), names=("truth", "mahony"), **options):
    """A benchmark; options are of `bench`, of its settings, or fields of every scenario."""
    workers = options.pop("workers", 1)
    of_flights = {key: options.pop(key) for key in ("seeds", "seed", "tuning") if key in options}
    return bench(
        scenarios,
        names,
        out,
        FlightSettings(**{"seeds": 2} | of_flights),
        {"duration_s": SHORT} | options,
        workers=workers,
    )
