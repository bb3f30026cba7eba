"""The circuit's export in C99 against the one that flies: every integer and every output."""

import numpy as np
import pytest
from c_export import SAMPLES, built, hard_readings

from estimators.circuit.circuit_estimator import circuit_estimator
from estimators.circuit.file import CircuitConfig, save_circuit
from estimators.circuit.parameters import untrained
from estimators.export.circuit_c import write_circuit_c
from estimators.export.formats import export_weights

VECTORS, GATES = 6, 16


def circuit(seed=0):
    """Parameters whose gates all open at times and whose bias learns fast."""
    p = untrained(VECTORS, GATES, seed, weight_noise=1.0)
    return p._replace(
        gate=p.gate + 0.2,
        resume=np.linspace(-0.5, 1.5, GATES),
        learn=np.array([1.0, -0.7]),
        pairs=np.array([[1, 6], [2, 7]]),
        scale=p.scale * 1.1,
    )


def c_state(vectors, gates):
    """The layout of the exported circuit's state in memory, axes first."""
    signed = [
        ("inputs", (6,)),
        *((name, (3,)) for name in ("angle", "force")),
        *((name, (3, vectors)) for name in ("x", "y", "turned")),
        *((name, (3, gates)) for name in ("drive", "z")),
        ("felt", (3, 3)),
        ("gate", (gates,)),
        ("bias", (4, 3)),
        ("ring", (1,)),
        *((name, ()) for name in ("missing", "age", "good")),
    ]
    fields = [(name, np.int32, shape) for name, shape in signed]
    return np.dtype([*fields, ("passed", np.int8, (3, gates))], align=True)


@pytest.fixture
def compiled(tmp_path):
    """Compile an export: a function from samples (T, 6) to an array of states and outputs."""

    def build(p, steps):
        config = CircuitConfig(vectors=VECTORS, gates=GATES, steps_per_sample=steps)
        save_circuit(tmp_path / "circuit.safetensors", config, p)
        source = export_weights(tmp_path / "circuit.safetensors", tmp_path / "c", "c99")
        return built(source, "att_snn", np.dtype([("state", c_state(VECTORS, GATES)), ("up", float, 3)]))

    return build


@pytest.mark.parametrize("steps", [1, 2, 4])
def test_the_c_source_has_every_integer_and_output_of_the_circuit(compiled, steps):
    p = circuit(steps)
    samples = hard_readings(steps)
    found = compiled(p, steps)(samples)
    assert len(found) == SAMPLES
    est = circuit_estimator("att-snn", p, steps)
    passed = np.zeros((3, GATES), bool)
    for t, (row, theirs) in enumerate(zip(samples, found, strict=True)):
        est.update(row[None, :3], row[None, 3:])
        for name in theirs["state"].dtype.names:
            state = theirs["state"][name].ravel(), est.states[0][name].ravel()
            np.testing.assert_array_equal(*state, err_msg=f"{name} at {t}")
        assert est.up is not None
        np.testing.assert_array_equal(theirs["up"], est.up[0], err_msg=f"up at {t}")
        passed |= est.states[0]["passed"].reshape(3, GATES) != 0
    assert passed.any(axis=0).sum() > GATES // 2
    assert np.any(found["state"]["bias"] != 0, axis=(0, 2)).all()
    assert est.skipped[0] > 33


def test_a_circuit_without_weights_or_products_compiles_and_says_level(compiled):
    p = untrained(VECTORS, GATES)
    empty = {name: np.zeros_like(getattr(p, name)) for name in ("mix", "give", "take", "pull", "read")}
    p = p._replace(**empty, learn=np.zeros(0), pairs=np.zeros((0, 2), np.int64))
    samples = np.tile([0.0, 0.0, 0.0, 0.0, 0.0, 9.81], (20, 1))
    np.testing.assert_array_equal(compiled(p, 4)(samples)["up"], np.tile([0.0, 0.0, 1.0], (20, 1)))


@pytest.mark.parametrize(("format", "known"), [("nir", ""), ("onnx", ""), ("csv", 'unknown format "csv"; ')])
def test_a_circuit_is_exported_as_c99_only(tmp_path, format, known):
    path = tmp_path / "circuit.safetensors"
    save_circuit(path, CircuitConfig(vectors=VECTORS, gates=GATES), circuit())
    with pytest.raises(ValueError, match=f"{known}weights of a circuit are exported as c99$"):
        export_weights(path, tmp_path / "x", format)
    with pytest.raises(ValueError, match="exists already"):
        export_weights(path, tmp_path, "c99")


@pytest.mark.parametrize(
    ("names", "value", "message"),
    [
        (["tau"], 1e-4, "longer than a step"),
        (["pull"], 1e5, "within 24 bits"),
        (["level"], 10.0, "within 24 bits"),
        (["mix", "give"], 6e3, "within 32 bits"),
    ],
)
def test_numbers_that_c_integers_cannot_hold_are_refused(tmp_path, names, value, message):
    p = untrained(64, 256)
    p = p._replace(**{name: np.full_like(getattr(p, name), value) for name in names})
    with pytest.raises(ValueError, match=message):
        write_circuit_c(tmp_path / "c", CircuitConfig(vectors=64, gates=256), p)
