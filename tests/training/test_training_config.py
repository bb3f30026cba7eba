import numpy as np
import pytest

from quadsim.cli.options import fields_of
from quadsim.config.toml import load_toml, preset_names
from quadsim.dataset import open_dataset
from quadsim.held_out import reserved_by
from training.circuit import flight_sets
from training.circuit.flight_sets import own_flights
from training.config import CircuitRun, TrainConfig, TrainingRecipe, is_of_circuit, make_config

CONTROL, CIRCUIT = {"preset": "control-attitude", "data": ()}, {"preset": "att-snn"}


@pytest.mark.parametrize(
    ("choices", "message"),
    [
        ({"preset": "fast"}, r'unknown preset "fast"; valid: att-snn, control-a.*, tune, or a path'),
        ({"epoch": 3}, 'unknown key "epoch"; did you mean "epochs"'),
        ({"rate_targets": [0.1, -1]}, r"training: rate_targets\[1\] = -1: should be 0 to"),
        ({"data": ()}, "data: at least one dataset to train on is required"),
        ({"data": ("x.zarr", "./x.zarr")}, "a dataset is given twice"),
        ({"imu": "rouhg"}, r'unknown imu "rouhg"; did you mean "rough"'),
        ({"model": "att-rnn", "hidden": 4}, r"att-rnn: layers of 100 and 4 units, should be equal"),
        (CONTROL | {"quantised": False}, "is trained quantised"),
        ({"preset": "control-attitude"}, "leave out data"),
        (CONTROL | {"control": {"rounds": 60}}, "should be at least the rounds"),
        (CONTROL | {"control": {"flight_s": 1.0}}, r"should be at most control\.flight_s"),
        ({"preset": "tune", "data": ()}, "data: at least one dataset to train on is required"),
        (CIRCUIT | {"epochs": 3}, "--epochs is not for the circuit of att-snn"),
        (CIRCUIT | {"model": "att-rnn"}, "--model is not for the circuit of att-snn"),
    ],
)
def test_bad_choices_give_one_clear_line(choices, message):
    with pytest.raises(ValueError, match=message) as error:
        make_config(**{"data": "x.zarr"} | choices)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("model", ["att-snn", "att-rnn"])
@pytest.mark.parametrize("name", [name for name in preset_names("presets") if not is_of_circuit(name)])
def test_every_shipped_preset_loads(name, model):
    preset = load_toml(name, "presets", TrainingRecipe)
    if preset.outputs == "angular-acceleration":
        pytest.skip("a controller is an Att-SNN")
    config = make_config(name, data="x", model=model)
    assert config.preset == name


def test_a_preset_of_the_user_s_is_a_file(tmp_path):
    mine = tmp_path / "mine.toml"
    mine.write_text("epochs = 7\n[imu.gyro]\nturn_on = 0.02\n")
    config = make_config(mine, data="x", imu={"accel": {"turn_on": 0.3}})
    gyro, accel = config.imu.gyro, config.imu.accel
    assert (config.epochs, gyro.turn_on, accel.turn_on, accel.noise) == (7, 0.02, 0.3, 0.0)
    mine.write_text("[imu.gyro]\nturn_onn = 0.02\n")
    with pytest.raises(ValueError, match=r'unknown key "gyro\.turn_onn"; did you mean "turn_on"'):
        make_config(mine, data="x")


def test_a_circuit_without_data_makes_the_flights_of_its_preset(tmp_path):
    sets, seen = [{"recipe": "hand-held", "flights": {"crazyflie": 1}}], []
    config = make_config("att-snn", seed=2, flight_sets=sets)
    made = own_flights(config, tmp_path, lambda done, total: seen.append((done, total)))
    assert seen[-1] == (1, 1)
    assert open_dataset(made.data[0]).sizes["time"] == 12_000
    assert own_flights(config, tmp_path).data == made.data
    with pytest.raises(ValueError, match="the flights of another training, choose another --out"):
        own_flights(config.model_copy(update={"seed": 3}), tmp_path)
    with pytest.raises(ValueError, match="window_s: 90, but the flights have 60 s"):
        own_flights(config.model_copy(update={"window_s": 90.0}), tmp_path)


def test_no_seed_of_these_flights_is_held_out(tmp_path, monkeypatch):
    """The eighth set of seed 2 would have one of the suite of 0.3."""
    seeds = []
    monkeypatch.setattr(flight_sets, "generate", lambda *args, seed, **_: seeds.append(seed) or "")
    own_flights(make_config("att-snn", seed=2), tmp_path)
    drawn = [int(np.random.SeedSequence([2, k]).generate_state(1)[0]) for k in range(len(seeds))]
    differs = [k for k, pair in enumerate(zip(seeds, drawn, strict=True)) if pair[0] != pair[1]]
    assert differs == [7]
    assert reserved_by(drawn[7])
    assert not any(map(reserved_by, seeds))


def test_every_field_is_documented():
    for kind in (TrainConfig, CircuitRun):
        assert all(field.description for field in kind.model_fields.values())


def test_dotted_settings_of_the_command_line_add_up():
    found = fields_of(["inputs.gyro=0.5", "inputs.accel_offset=[0,0,1]", "epochs=3", "a=true", "b=wide"])
    inputs = {"gyro": 0.5, "accel_offset": [0, 0, 1]}
    assert found == {"inputs": inputs, "epochs": 3, "a": True, "b": "wide"}
