"""What a benchmark cost: flights, hours of flight, processor time, and the estimator that took most of it."""

from typing import NamedTuple

from .runner import Results


class Cost(NamedTuple):
    """Of all cells, those that an earlier run finished among them."""

    flights: int
    flight_s: float  #: time in the air, over all flights [s]
    cpu_s: float  #: processor time [s]; 0 where it was not measured
    slowest: str  #: the estimator, of all but references, with the largest share of it; empty without any
    share: float  #: that share

    def __str__(self) -> str:
        """In words: "1200 flights, 6.2 h in the air; 12.3 min of processor time, ..."."""
        text = f"{self.flights} flight{'s' if self.flights != 1 else ''}, {hours(self.flight_s)} in the air"
        if not self.cpu_s:
            return text
        text += f"; {hours(self.cpu_s)} of processor time"
        text += f", {100 * self.share:.0f} % of it with {self.slowest}" if self.slowest else ""
        return f"{text}, {self.flights / self.cpu_s:.1f} flights per second"


def cost_of(results: Results) -> Cost:
    """Add up the cells."""
    spent = dict.fromkeys(results.estimators, 0.0)
    for cell in results.cells:
        spent[cell.estimator] += cell.cpu_s
    total, flights = sum(spent.values()), results.flights
    others = [name for name in spent if name not in results.references]
    slowest = max(others, key=lambda name: spent[name], default="") if total else ""
    share = spent[slowest] / total if slowest else 0.0
    return Cost(len(flights), sum(flight.flown_s for flight in flights), total, slowest, share)


def hours(seconds: float) -> str:
    """A duration: "12 s", "3.4 min", "6.2 h"."""
    if seconds < 100.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.1f} min" if seconds < 6000.0 else f"{seconds / 3600:.1f} h"
