"""`quadsim paper` at a tiny size: stored stages, claims judged from numbers, complete pages."""

import json
import re
from dataclasses import asdict
from string import Formatter

import numpy as np
import pytest

from paper import tables
from paper.claims import CLAIMS, judge, scatter
from paper.figures import FIGURES
from paper.pages import sections
from paper.plan import ITEMS, TRAINED_ON, chosen, stages_of
from paper.quoted import NOT_QUOTED
from paper.run import paper
from paper.settings import PRESETS, Budget, PaperSettings, settings_of
from paper.stages import RECORD, Stage, run_stages, with_inputs
from paper.work import NUMBERS, fly
from training.cross_domain import Score

SHORT = Budget(epochs=1, batches=1, batch_size=2, window_s=0.5, windows_per_stream=1)
LONGER = SHORT.model_copy(update={"epochs": 4})
TINY = PaperSettings(
    preset="quick",
    sim_flights=4,
    real_flights=4,
    validation_flights=(1, 1),
    test_flights=(2, 2),
    flight_s=6.0,
    folds=2,
    particles=2,
    iterations=1,
    main=LONGER,
    paper=LONGER,
    rnn=LONGER,
    fold_snn=SHORT,
    fold_rnn=SHORT,
    study=SHORT,
    rates_hz=(100.0, 200.0),
    rate_flights=(1, 1, 1),
    rate=SHORT,
    sizes=(20, 200),
    minutes_flights=(1, 4),
    latency_rounds=1,
    loop_seeds=1,
    loop_s=2.0,
)


# --- stages ---


def note(folder, inputs, **settings):
    """A stage that writes its arguments, after what an earlier attempt wrote."""
    file = folder / "text"
    before = file.read_text() if file.exists() else ""
    file.write_text(before + str(settings) + "".join((inputs[name] / "text").read_text() for name in inputs))


def chain(first=1, second=2):
    return [
        Stage("a", note, {"x": first}),
        Stage("b", note, {"y": second}, ("a",)),
        Stage("c", note, {}, ("b",)),
        Stage("d", note, {}, ("a",)),
    ]


def test_a_rerun_makes_nothing(tmp_path):
    assert run_stages(chain(), tmp_path, workers=1) == ["a", "b", "c", "d"]
    assert run_stages(chain(), tmp_path, workers=1) == []


def test_a_changed_setting_redoes_only_what_depends_on_it(tmp_path):
    run_stages(chain(), tmp_path, workers=1)
    assert run_stages(chain(second=3), tmp_path, workers=1) == ["b", "c"]
    assert (tmp_path / "c" / "text").read_text() == "{}{'y': 3}{'x': 1}"
    assert run_stages(chain(first=5, second=3), tmp_path, workers=1) == ["a", "b", "c", "d"]


def test_a_killed_stage_continues_in_its_folder(tmp_path):
    run_stages(chain(), tmp_path, workers=1)
    record = tmp_path / "d" / RECORD
    record.write_text(re.sub(r', "seconds": [\d.]+', "", record.read_text()))  # as if killed before its end
    assert run_stages(chain(), tmp_path, workers=1) == ["d"]
    assert (tmp_path / "d" / "text").read_text() == "{}{'x': 1}{}{'x': 1}"


def test_inputs_are_found_at_any_depth_and_come_first():
    stages = {stage.name: stage for stage in chain()}
    assert [stage.name for stage in with_inputs(stages, ["c"])] == ["a", "b", "c"]


def test_the_number_of_workers_changes_nothing(tmp_path):
    settings = {"domain": "sim", "flights": 1, "duration_s": 1.0, "seed": 1}
    stages = [Stage("one", fly, settings), Stage("two", fly, settings | {"seed": 2}, alone=True)]
    reported = []
    for workers in (1, 2):
        run_stages(stages, tmp_path / str(workers), workers, lambda *now: reported.append(now))
    for name in ("one", "two"):
        first, second = (
            {path.relative_to(root): path.read_bytes() for path in root.rglob("c/*") if path.is_file()}
            for root in (tmp_path / "1" / name, tmp_path / "2" / name)
        )
        assert first == second
    assert reported[0][:2] == (0, 10)
    assert reported[-1][:2] == (10, 10)


# --- what there is to make ---


@pytest.mark.parametrize("preset", PRESETS)
def test_every_stage_is_required_and_comes_after_its_inputs(preset):
    stages, shows = stages_of(settings_of(preset))
    assert list(shows) == list(ITEMS)
    names = list(stages)
    for place, stage in enumerate(stages.values()):
        assert set(stage.inputs) <= set(names[:place])
    needed = with_inputs(stages, [name for names in shows.values() for name in names])
    assert {stage.name for stage in needed} == set(stages)


def test_full_has_the_papers_sizes():
    full = settings_of("full")
    assert (full.sim_flights, full.real_flights, full.flight_s, full.folds) == (35, 11, 100.0, 5)


def test_items_are_chosen_by_name():
    assert chosen("fig5, Table 1") == ["table1", "fig5"]
    assert chosen(None) == list(ITEMS)
    with pytest.raises(ValueError, match='did you mean "table1"'):
        chosen("fig5,tabel1")


@pytest.mark.parametrize("item", ITEMS)
def test_every_item_has_its_text_and_every_gap_is_filled(item):
    _, text = sections()[item]
    gaps = {re.split(r"[.\[]", name)[0] for _, name, _, _ in Formatter().parse(text) if name}
    assert all(gap in ("s", "n") or callable(getattr(tables, gap)) for gap in gaps)


def test_claims_and_figures_are_of_items():
    assert {claim.item for claim in judge({})} == {function.__name__ for function in CLAIMS} <= set(ITEMS)
    assert set(FIGURES) <= set(ITEMS)
    assert all(claim.claim and claim.rule for claim in judge({}))


# --- claims, judged from made-up numbers ---

FOUR = ("complementary", "mahony", "madgwick", "ekf")


def errors(snn):
    every = dict.fromkeys(FOUR, 3.0) | {"att-rnn": 2.0, "att-snn": snn, "ekf": 2.0}
    one = {"sequences": {name: {"unknown": [error, error]} for name, error in every.items()}}
    return {"score-test-sim": one, "score-test-real": one}


def losses(snn, rnn):
    def curve(noise):
        return {"val_mse": [1.0 + noise * (-1) ** k for k in range(40)]}

    return {"net-snn": curve(snn), "net-snn-float": curve(snn), "net-rnn": curve(rnn)}


def domains(other):
    def score(model, fold, trained, tested, error):
        return asdict(Score(model, trained, fold, tested, 1, error, 0.0, 1))

    return {
        f"fold-{model}-{k}": {
            "scores": [score(model, k, "sim", "real", other), score(model, k, "real", "(test)", 2.0)]
        }
        for model in ("att-snn", "att-rnn")
        for k in (0, 1)
    }


def recovery(network, slowest):
    times = dict.fromkeys([*FOUR, "complementary-adaptive"], 3.0) | {"mahony": slowest}
    times |= {"att-snn": network, "att-rnn": network}
    return {"recover": {"curves": {name: {"flight": {"first_s": time}} for name, time in times.items()}}}


def inside(quarter=2.0, slow=(0.9, 0.2), fast=(0.2, 0.9), gru=120000.0):
    gains = {
        "gyro removed": {"slow_gain": slow[0], "fast_gain": fast[0]},
        "accel removed": {"slow_gain": slow[1], "fast_gain": fast[1]},
    }
    return {
        "inside": {
            "fractions": [0.0, 0.25, 0.5],
            "ablation": {"activity": [2.0, quarter, 9.0], "random": [2.0, 3.0, 9.0]},
            "silent": [1, 2],
            "responses": gains,
            "flops": {"gru": gru, "dense": 40000.0, "sparse": 5000.0},
        }
    }


def rates(*of_each):
    return {
        f"compare-rate-{100 * 2**k}": {"errors": {TRAINED_ON: {"x": [error]}}}
        for k, error in enumerate(of_each)
    }


def loop(crashes, last):
    return {
        "loop": {
            "scenarios": {
                "hover": {"att-snn": {"crashes": crashes, "flights": 4, "parts_deg": [1.0, 1.0, last]}}
            }
        }
    }


@pytest.mark.parametrize(
    ("item", "numbers", "verdict"),
    [
        ("table2", errors(2.5), "holds"),
        ("table2", errors(3.5), "does not hold"),
        ("fig4", losses(0.2, 0.1), "holds"),
        ("fig4", losses(0.1, 0.2), "does not hold"),
        ("table1", domains(4.0), "holds"),
        ("table1", domains(2.1), "does not hold"),
        ("fig6", recovery(0.5, 8.0), "holds"),
        ("fig6", recovery(1.5, 8.0), "partly"),
        ("fig6", recovery(None, 8.0), "does not hold"),
        ("fig7", inside(quarter=2.02), "holds"),
        ("fig7", inside(quarter=2.5), "does not hold"),
        ("fig8", inside(), "holds"),
        ("fig8", inside(slow=(0.1, 0.2)), "partly"),
        ("fig8", inside(slow=(0.1, 0.2), fast=(0.9, 0.2)), "does not hold"),
        ("flops", inside(), "holds"),
        ("flops", inside(gru=50000.0), "partly"),
        ("flops", inside(gru=5000.0), "does not hold"),
        ("rate", rates(4.0, 3.0, 2.0), "holds"),
        ("rate", rates(4.0, 5.0, 3.0), "partly"),
        ("rate", rates(2.0, 2.0, 2.0), "does not hold"),
        ("loop", loop(0, 1.1), "holds"),
        ("loop", loop(1, 1.1), "partly"),
        ("loop", loop(0, 1.5), "does not hold"),
    ],
)
def test_a_claim_is_judged_from_the_numbers(item, numbers, verdict):
    judged = {each.item: each for each in judge(numbers)}
    assert judged[item].verdict == verdict
    assert judged[item].measured
    others = {each.verdict for each in judge({}) if each.item != item}
    assert others == {"not judged"}


def test_scatter_is_that_of_white_noise_with_any_trend():
    noise = np.random.default_rng(0).normal(0.0, 0.05, 4000)
    assert scatter(np.exp(noise - 0.001 * np.arange(4000)).tolist()) == pytest.approx(0.05, rel=0.05)


# --- the whole ---


@pytest.mark.slow
def test_the_whole_paper_in_small(tmp_path):
    done = paper(tmp_path, workers=1, settings=TINY)
    assert {each.verdict for each in done.judged} <= {"holds", "partly", "does not hold"}
    assert "of the paper's 9 claims" in done.headline
    pages = {name: (tmp_path / f"{name}.md").read_text() for name in ("paper", "rate", "size", "minutes")}
    for text in pages.values():
        assert "simulated too" in text
        assert not re.search(r"\{\w*\}", text)
        for link in re.findall(r"\]\(([^)]+)\)", text):
            assert link.startswith("https://") or (tmp_path / link).stat().st_size > 0
        for figure in re.findall(r"\]\((\w+)\.png\)", text):
            assert (tmp_path / f"{figure}.svg").is_file()
    assert "Not made in this run" not in pages["paper"]
    assert NOT_QUOTED in pages["paper"]
    scored = json.loads((tmp_path / "quick" / "score-test-sim" / NUMBERS).read_text())["sequences"]
    for name, starts in scored.items():
        assert set(starts) == ({"unknown"} if name.startswith("att") else {"unknown", "known"})
    for settings, again in ((TINY, []), (TINY.model_copy(update={"loop_s": 1.5}), ["loop"])):
        stages, _ = stages_of(settings)
        assert run_stages(with_inputs(stages, stages), tmp_path / "quick", workers=1) == again
