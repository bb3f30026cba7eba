"""`quadsim paper` at a tiny size: stored stages, claims judged from numbers, complete pages."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from paper.page.claims import CLAIMS, QUANTITIES, bootstrap_interval, judge_claims, operations, ratio, scatter
from paper.page.paper_figures import FIGURES
from paper.plan import CROSS, ITEMS, PRESETS, chosen, sizes_of, stages_of
from paper.run import paper
from paper.stages import NUMBERS, RECORD, Stage, run_stages, with_inputs
from paper.work import trainings
from quadsim.held_out import load_held_out
from quadsim.runs.fingerprint import ROOT, closure

SHORT = dict(epochs=2, batches=1, batch_size=2, window_s=0.5)
SHORTER = SHORT | {"epochs": 1}
TINY = sizes_of("quick") | dict(
    sim_flights=3,
    real_flights=3,
    flight_s=6.0,
    test_flights=2,
    test_s=6.0,
    folds=2,
    particles=2,
    iterations=1,
    snn=SHORT,
    rnn=SHORTER,
    fold=SHORTER,
    rates_hz=(100.0,),
    rate_flights=3,
    rate=SHORTER,
    minutes=(1,),
    minutes_validation=1,
    study=SHORTER,
    latency_rounds=1,
    loop_seeds=1,
    loop_s=2.0,
)


def note(folder, after=(), **settings):
    """A stage that writes its arguments, after what an earlier attempt wrote."""
    file = folder / "text"
    before = file.read_text() if file.exists() else ""
    file.write_text(before + str(settings) + "".join((each / "text").read_text() for each in after))


def chain(first=1, second=2):
    a = Stage("a", note, {"x": first})
    b = Stage("b", note, {"y": second, "after": [a]})
    return [a, b, Stage("c", note, {"after": [b]}), Stage("d", note, {"after": (a,)})]


def test_a_rerun_makes_what_depends_on_a_changed_setting_and_nothing_else(tmp_path):
    reported = []
    assert run_stages(chain(), tmp_path, 1, lambda *now: reported.append(now)) == ["a", "b", "c", "d"]
    assert reported == [(0, 4, ""), (1, 4, "a"), (2, 4, "b"), (3, 4, "d"), (4, 4, "c")]
    assert run_stages(chain(), tmp_path, workers=1) == []
    assert run_stages(chain(second=3), tmp_path, workers=1) == ["b", "c"]
    assert (tmp_path / "c" / "text").read_text() == "{}{'y': 3}{'x': 1}"
    assert run_stages(chain(first=5, second=3), tmp_path, workers=1) == ["a", "b", "c", "d"]


def test_a_killed_stage_continues_in_its_folder(tmp_path):
    run_stages(chain(), tmp_path, workers=1)
    record = tmp_path / "d" / RECORD
    record.write_text(re.sub(r', "seconds": [\d.]+', "", record.read_text()))  # as if killed before its end
    assert run_stages(chain(), tmp_path, workers=1) == ["d"]
    assert (tmp_path / "d" / "text").read_text() == "{}{'x': 1}{}{'x': 1}"


@pytest.mark.parametrize(("file", "content"), [(RECORD, "{}"), ("text", None)])
def test_a_stage_with_an_empty_record_or_a_lost_file_is_made_again(tmp_path, file, content):
    run_stages(chain(), tmp_path, workers=1)
    path = tmp_path / "d" / file
    path.unlink() if content is None else path.write_text(content)
    assert run_stages(chain(), tmp_path, workers=1) == ["d"]


def test_seeds_of_the_held_out_suite_are_refused_at_once():
    with pytest.raises(ValueError, match="held-out suite"):
        sizes_of("quick", load_held_out("0.2").seed)


def test_a_training_too_short_for_the_scatter_is_said_so():
    short = {name: {"val_mse": [1.0] * 30} for name in ("net-snn", "net-rnn")}
    (found,) = (each for each in judge_claims(short) if "noisier" in each.claim)
    assert (found.verdict, found.measured) == ("not judged", "the measure needs trainings of 62 epochs")


@pytest.mark.parametrize("preset", PRESETS)
def test_every_stage_is_required_and_comes_after_its_inputs(preset):
    stages, shows = stages_of(sizes_of(preset))
    assert list(shows) == list(ITEMS)
    names = list(stages)
    for place, stage in enumerate(stages.values()):
        assert {each.name for each in stage.inputs} <= set(names[:place])
    needed = with_inputs(stages, [name for names in shows.values() for name in names])
    assert [stage.name for stage in needed] == names


def test_items_are_chosen_by_name():
    assert chosen("fig5, Table 1") == ["table1", "fig5"]
    assert chosen(None) == list(ITEMS)
    with pytest.raises(ValueError, match='did you mean "table1"'):
        chosen("fig5,tabel1")


def test_the_page_shows_every_item_in_their_order():
    text = (ROOT / "paper" / "page" / "sections.md").read_text()
    assert re.findall(r'call item\("(\w+)"', text) == list(ITEMS)


def test_claims_and_figures_are_of_items():
    assert {claim.item for claim in judge_claims({})} <= set(ITEMS)
    assert set(FIGURES) <= set(ITEMS)
    assert {each["quantity"] for each in CLAIMS["claim"]} == set(QUANTITIES)


def test_operations_follow_the_papers_formulas():
    assert operations(100, 100) == {"snn": 20_200, "gru": 60_300}


FOUR = ("complementary", "mahony", "madgwick", "ekf")


def errors(snn, rnn=2.0):
    every = dict.fromkeys(FOUR, 3.0) | {"att-rnn": rnn, "att-snn": snn}
    sequences = {name: {"unknown": [error - 0.1, error, error + 0.1]} for name, error in every.items()}
    return {"score-fly-test-real": {"sequences": sequences}}


def losses(snn, rnn):
    curves = ([1.0 + noise * (-1) ** (k // 7) for k in range(200)] for noise in (snn, rnn))
    return {name: {"val_mse": curve} for name, curve in zip(("net-snn", "net-rnn"), curves, strict=True)}


def domains(other):
    folds = {name: {"test": [2.0, 2.1, 1.9]} for name in ("net-snn", "net-fold-1")}
    return {"score-folds": folds | {name: {"test": [other, other + 0.1]} for name in CROSS}}


def recovery(network, filters):
    times = dict.fromkeys([*FOUR, "complementary-adaptive"], filters)
    times |= {"att-snn": network, "att-rnn": network}
    curves = {name: {"flight": {"times_s": [time] * 5}} for name, time in times.items()}
    return {"recover": {"curves": curves}}


def inside(after=2.0, neurons=150, gru=120000.0):
    found = {"rates": [[0.1] * 100] * 2, "ablation": {"activity": [2.0, 2.5]}}
    found["without_rare"] = {"error_deg": after, "neurons": neurons}
    return {"inside": found | {"flops": {"gru": gru, "dense": 40000.0, "sparse": 5000.0}}}


def responses(slow=(0.9, 0.2), fast=(0.2, 0.9)):
    gains = zip(("gyro removed", "accel removed"), slow, fast, strict=True)
    ways = {way: {"slow_gain": below, "fast_gain": above} for way, below, above in gains}
    return {"manipulate": {"networks": {"net-snn": ways}}}


def rates(*of_each):
    near = {100 * 2**k: [error, error + 0.1, error - 0.1] for k, error in enumerate(of_each)}
    return {
        f"score-rate-{hz}": {"sequences": {"att-snn": {"unknown": each}}}
        for hz, each in reversed(near.items())
    }


def minutes(*of_each):
    found = zip(("10", "30", "60"), of_each, strict=True)
    return {"score-minutes": {"sequences": {n: {"unknown": [error, error + 0.1]} for n, error in found}}}


def loop(crashes, last):
    flown = {"crashes": crashes, "flights": 4, "parts_deg": [1.0, 1.0, last]}
    return {"loop": {"scenarios": {"hover": {"att-snn": flown}}}}


JUDGED = {
    "that of the classical filters": {"holds": errors(3.1), "does not hold": errors(3.5)},
    "more accurate than Att-SNN": {"holds": errors(2.5), "does not hold": errors(1.5)},
    "noisier": {"holds": losses(0.2, 0.1), "does not hold": losses(0.1, 0.2)},
    "single source": {"holds": domains(4.0), "does not hold": domains(2.1)},
    "From an initial error of 20°": {
        "holds": recovery(0.5, 8.0), "partly": recovery(1.5, 8.0), "does not hold": recovery(None, 8.0)
    },
    "than 7 s": {"partly": recovery(0.5, 3.0)},
    "removed without loss": {
        "holds": inside(), "partly": inside(neurons=190), "does not hold": inside(after=2.1)
    },
    "reference at a constant attitude": {
        "holds": responses(), "partly": responses(slow=(0.1, 0.2)),
        "does not hold": responses((0.1, 0.2), (0.9, 0.2)),
    },
    "3 times the operations": {"holds": inside()},
    "data rates": {
        "holds": rates(4.0, 3.0, 2.0), "partly": rates(4.0, 5.0, 3.0), "does not hold": rates(2.0, 2.0, 2.5)
    },
    "20 minutes": {
        "holds": minutes(2.0, 2.0, 2.0), "partly": minutes(2.5, 2.0, 2.0),
        "does not hold": minutes(4.0, 4.0, 2.0),
    },
    "accumulate": {"holds": loop(0, 1.1), "partly": loop(1, 1.1), "does not hold": loop(0, 1.5)},
}  # fmt: skip


@pytest.mark.parametrize(
    ("claim", "verdict", "numbers"),
    [(claim, verdict, numbers) for claim, each in JUDGED.items() for verdict, numbers in each.items()],
)
def test_a_claim_is_judged_from_the_numbers(claim, verdict, numbers):
    (found,) = (each for each in judge_claims(numbers) if claim in each.claim)
    assert found.verdict == verdict
    assert found.measured
    assert {each.verdict for each in judge_claims({})} == {"not judged"}
    assert {each.verdict for each in judge_claims(numbers, judges=False)} == {"not judged"}


def test_scatter_is_the_standard_deviation_about_the_moving_average():
    noise = np.random.default_rng(0).normal(0.0, 0.05, 100_000)
    assert scatter((1.0 + noise).tolist()) == pytest.approx(0.05 * np.sqrt(1 - 1 / 20), rel=0.01)
    assert np.isnan(scatter([1.0] * 40))


def test_an_interval_covers_the_number_as_often_as_it_says():
    rng = np.random.default_rng(1)
    samples = rng.normal(2.0, 1.0, (60, 30))
    found = [bootstrap_interval(lambda x: float(x.mean()), sample) for sample in samples]
    assert 0.86 <= np.mean([each.low < 2.0 < each.high for each in found]) <= 0.98


def test_a_ratio_of_the_same_flights_has_no_spread_if_they_are_paired():
    flights = [1.0, 2.0, 3.0]
    assert ratio(flights, flights, paired=True) == (1.0, 1.0, 1.0)
    assert ratio(flights, flights).low < 0.9


def test_a_trainings_fingerprint_does_not_depend_on_the_pages_code():
    files = {path.relative_to(ROOT).as_posix() for path in closure([Path(trainings.__file__)], ROOT)}
    assert "training/epochs.py" in files
    assert not any(file.startswith(("paper/page/", "paper/plan", "scenarios/")) for file in files)


@pytest.mark.slow
def test_the_whole_paper_in_small(tmp_path):
    done = paper(tmp_path, workers=1, sizes=TINY)
    assert {each.verdict for each in done.judged} == {"not judged"}
    assert f"of the paper's {len(CLAIMS['claim'])} claims" in done.headline
    text = (tmp_path / "paper.md").read_text()
    assert "simulated too" in text
    assert "It judges no claim" in text
    assert not re.search(r"[{}]", text)
    for link in re.findall(r"\]\(([^)]+)\)", text):
        assert link.startswith("https://") or (tmp_path / link).stat().st_size > 0
    assert "Not made in this run" not in text
    scored = json.loads((tmp_path / "quick" / "score-fly-test-sim" / NUMBERS).read_text())["sequences"]
    for name, starts in scored.items():
        assert set(starts) == ({"unknown"} if name.startswith("att") else {"unknown", "known"})
    for sizes, again in ((TINY, []), (TINY | {"loop_s": 1.5}, ["loop"])):
        stages, _ = stages_of(sizes)
        assert run_stages(with_inputs(stages, stages), tmp_path / "quick", workers=1) == again
