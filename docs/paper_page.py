"""The page of a finished `quadsim paper --preset full --out runs/paper`: `python docs/paper_page.py`.

Its networks and filters are scored elsewhere too: on flights of RotorPy, a simulator by other authors, and on
real recordings, which are not part of the repository.
"""

from collections.abc import Mapping
from pathlib import Path

from foreign import DESCRIPTION, foreign_error
from pages import ROOT, load_page
from recordings import FOLDER, recordings, score
from simulated import options

from estimators import create
from estimators.evaluation.comparison import silenced_twin
from estimators.evaluation.logs import LEVEL, RAW
from paper.page.pages import Placement
from paper.page.tables import markdown_table
from paper.plan import CHIP, OURS, RNN, SNN
from paper.run import write_results
from paper.settings import settings_of
from paper.work.files import TUNING, WEIGHTS
from quadsim.estimator import AttitudeEstimator

NETWORKS = {
    "Att-SNN": ("att-snn", SNN),
    "Att-SNN (Loihi quantisation)": ("att-snn-loihi", CHIP),
    "Att-RNN": ("att-rnn", RNN),
    "*Att-SNN, our recipe*": ("att-snn-loihi", OURS),
}
FILTERS = ("complementary", "mahony", "madgwick", "ekf")
RATE_HZ = 200.0
SPLIT = "* **Split**: "
GPU = """* **Computers**: most trainings of this run began on a GPU, by code that has been removed
  since, then went on without. Both give the same spikes; gradients differ in the last digits.
"""
BEFORE = "## How our reading differs from the paper"
TEXT = """## Elsewhere

The same networks and filters on what neither trained nor tuned them, from an unknown start: {rotorpy}; and
real recordings, BROAD (moved by hand) and a Phantom 4 in flight. RotorPy: mean absolute error of roll and
pitch [°]. Recordings: mean inclination RMSE [°], raw gyroscope. *Always level* is what a network with output
weights of zero makes.

{table}
"""


def estimators_of(parts: Path) -> dict[str, AttitudeEstimator]:
    """The run's networks, and its filters as tuned."""
    made = {
        title: create(model, RATE_HZ, weights=parts / stage / WEIGHTS)
        for title, (model, stage) in NETWORKS.items()
    }
    return made | {name: create(name, RATE_HZ, tuning=parts / f"tune-{name}" / TUNING) for name in FILTERS}


def elsewhere(made: Mapping[str, AttitudeEstimator], data: Path, folder: Path) -> str:
    """The table of errors on foreign flights and on real recordings."""
    sets = {name: score(name, logs, made) for name, logs in recordings(folder).items()}
    twin = silenced_twin("att-snn")
    assert twin is not None
    rows = [
        [title, f"{foreign_error(lambda _, est=est: est, data):.2f}"]
        + [f"{each.mean(key, RAW):.2f}" for each in sets.values()]
        for title, key, est in [
            *((name, name, est) for name, est in made.items()),
            ("*always level*", LEVEL, twin),
        ]
    ]
    return markdown_table(" | ".join(["estimator", "RotorPy", *sets]), rows)


def main() -> None:
    """Write paper.md and its figures, these with few colours."""
    run = ROOT / "runs" / "paper"
    given = options(
        __doc__, None, run=(run, "folder of the run"), recordings=(FOLDER, "folder of broad/ and phantom4/")
    )
    page, parts = load_page("paper"), given.run / "full"
    placement = Placement("paper-", "img", ("png",), "python docs/paper_page.py")
    write_results(parts, page.root / "docs", settings_of("full"), placement)
    path = page.root / "docs" / "paper.md"
    table = elsewhere(estimators_of(parts), given.data, given.recordings)
    text = path.read_text().replace(BEFORE, f"{TEXT.format(rotorpy=DESCRIPTION, table=table)}\n{BEFORE}")
    path.write_text(text.replace(SPLIT, GPU + SPLIT))
    for written in page.made:
        if written.suffix == ".md":
            page.sign(written)
        else:
            page.sign_image(written, 64)
    print(path)


if __name__ == "__main__":
    main()
