"""The paper, rerun: a finished `quadsim paper --preset full --out runs/paper`, scored elsewhere too."""

from argparse import Namespace
from collections.abc import Iterator
from pathlib import Path

from foreign import DESCRIPTION, foreign_error
from pages import Part, Values, reduce_colours, row
from recordings import BROAD, PHANTOM4, recordings, score

from estimators import create
from estimators.evaluation.comparison import silenced_twin
from estimators.evaluation.logs import LEVEL, RAW
from paper.plan import CHIP, RNN, SNN, sizes_of
from paper.run import write_results
from paper.stages import TUNING, WEIGHTS

NETWORKS = {
    "Att-SNN": ("att-snn", SNN),
    "Att-SNN (Loihi quantisation)": ("att-snn-loihi", CHIP),
    "Att-RNN": ("att-rnn", RNN),
}
FILTERS = ("complementary", "mahony", "madgwick", "ekf")
RATE_HZ = 200.0


def elsewhere(parts: Path, data: Path, folder: Path) -> Iterator[str]:
    """Errors of the run's networks and filters on foreign flights and on real recordings."""
    made = {
        title: create(model, RATE_HZ, weights=parts / stage / WEIGHTS)
        for title, (model, stage) in NETWORKS.items()
    }
    made |= {name: create(name, RATE_HZ, tuning=parts / f"tune-{name}" / TUNING) for name in FILTERS}
    sets = recordings(folder)
    scores = [score(name, sets[name], made) for name in (BROAD, PHANTOM4)]
    twin = silenced_twin("att-snn")
    assert twin is not None
    for title, key, est in [
        *((name, name, est) for name, est in made.items()),
        ("*always level*", LEVEL, twin),
    ]:
        rotorpy = foreign_error(lambda _, est=est: est, data)
        yield row(title, f"{rotorpy:.2f}", *(f"{each.mean(key, RAW):.2f}" for each in scores))


def values(part: Part, given: Namespace) -> Values:
    """The run's page and figures, and the errors elsewhere."""
    parts = given.run / "full"
    write_results(parts, part.path.parent, sizes_of("full"))
    for figure in (part.path.parent / "img").glob("paper-*.png"):
        reduce_colours(figure, 64)
    return {
        "page": part.path.read_text("utf-8").rstrip("\n"),
        "rotorpy": DESCRIPTION,
        "elsewhere": list(elsewhere(parts, given.data, given.recordings)),
    }
