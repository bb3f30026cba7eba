"""Weights that the symmetry of a quadrotor shares."""

import numpy as np
import pytest
import torch
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from estimators.analysis.ablation import pruned
from estimators.networks.network import NetworkEstimator
from estimators.networks.on_chip import OnLoihi
from estimators.networks.symmetry import MIRROR, OPERATIONS, TURN, is_symmetric, weight_sharing
from quadsim.rotation import roll_pitch_of_up
from training.config import make_config
from training.init import ESTIMATOR_START, initialise_from_data
from training.loop import exported
from training.models import AttSNN

G = 9.81


def network(encoding, hidden, seed=0, outputs="roll-pitch"):
    """A symmetric network with a solved start; of odd seeds with after-spike currents."""
    rng, sizes = np.random.default_rng(seed), {"encoding": encoding, "hidden": hidden}
    config = make_config("hummingbird", data="x", outputs=outputs, after_spike=seed % 2 == 1, **sizes)
    model = AttSNN(config)
    x = np.round(rng.normal(size=(3, 300, 6)).cumsum(1) * 20) / 1024
    initialise_from_data(
        model, x, 0.1 * x[:, :, : len(model.w_out)], seed, ESTIMATOR_START._replace(fan_in=8)
    )
    return model, *exported(model, 200.0, {})


def readings(seed):
    rng = np.random.default_rng(seed)
    return rng.normal(size=(1, 200, 3)).cumsum(1) * 0.1, rng.normal(size=(1, 200, 3)) + np.array([0, 0, G])


def rolled_and_pitched(operation, roll_pitch):
    """Small roll and pitch in the new body axes, from the horizontal part (y, -x) of the world's up."""
    up = np.stack([-roll_pitch[..., 1], roll_pitch[..., 0]], -1) @ operation[:2, :2].T
    return np.stack([up[..., 1], -up[..., 0]], -1)


def test_the_operations_are_a_group_of_eight():
    known = {each.tobytes() for each in OPERATIONS}
    assert len(known) == 8
    assert all((a @ b).tobytes() in known for a in OPERATIONS for b in OPERATIONS)
    assert {TURN.tobytes(), MIRROR.tobytes()} < known


def test_small_roll_and_pitch_turn_as_the_outputs_do():
    up = np.array([0.01, -0.02, 0.99975])
    for operation in OPERATIONS:
        turned = roll_pitch_of_up(operation @ up)
        np.testing.assert_allclose(turned, rolled_and_pitched(operation, roll_pitch_of_up(up)), atol=1e-5)


@pytest.mark.parametrize("outputs", ["roll-pitch", "up"])
@given(encoding=st.integers(8, 40), hidden=st.integers(8, 40), seed=st.integers(0, 100))
@settings(max_examples=25, deadline=None)
def test_turned_and_mirrored_readings_give_exactly_the_turned_outputs(outputs, encoding, hidden, seed):
    """Up turns as a vector at any attitude."""
    _, config, tensors = network(encoding, hidden, seed, outputs)
    assert is_symmetric(tensors)
    est, (gyro, accel) = NetworkEstimator(OnLoihi(config, tensors), 200.0), readings(seed)
    straight = est.outputs(gyro, accel)
    assume(np.abs(straight).max() > 0)  # a single group of neurons may start silent
    for operation in OPERATIONS:
        est.reset(1)
        turned = est.outputs(np.linalg.det(operation) * gyro @ operation.T, accel @ operation.T)
        turn = rolled_and_pitched if outputs == "roll-pitch" else lambda m, up: up @ m.T
        np.testing.assert_array_equal(turned, turn(operation, straight))


@given(st.integers(1, 50), st.integers(1, 50), st.sampled_from([2, 3]))
@settings(max_examples=25, deadline=None)
def test_copies_and_means_are_fixed_by_the_symmetry(encoding, hidden, outputs):
    shapes = {
        "w_in": (encoding, 6),
        "w_ff": (hidden, encoding),
        "w_out": (outputs, hidden),
        "mem1": (hidden,),
    }
    for name, sharing in weight_sharing(encoding, hidden, outputs).items():
        if name in shapes:
            values = np.random.default_rng(0).normal(size=shapes[name])
            copied, mean = sharing.apply(values), sharing.mean(values)
            np.testing.assert_array_equal(sharing.apply(copied), copied)
            np.testing.assert_array_equal(sharing.apply(mean), mean)
            np.testing.assert_allclose(sharing.mean(copied), copied, atol=1e-12)
            assert np.linalg.norm(mean) <= np.linalg.norm(values)  # a projection


def test_a_hundred_neurons_a_layer_share_a_few_weights():
    shared = weight_sharing(100, 100)
    different = {name: len(np.unique(sharing.first[sharing.sign != 0])) for name, sharing in shared.items()}
    assert different["w_rec"] == different["w_ff"] == 1251  # of 10000
    assert different["mem0"] == different["mem1"] == 13


def test_gradients_are_shared_as_the_weights_are():
    model, _, _ = network(20, 24)
    x = torch.from_numpy(np.round(np.random.default_rng(1).normal(size=(3, 300, 6)).cumsum(1) * 20) / 1024)
    out, _ = model(x)
    out.square().mean().backward()
    for name, sharing in model.sharing.items():
        gradient = getattr(model, name).grad.numpy()
        np.testing.assert_array_equal(sharing.apply(gradient), gradient)
        assert np.abs(gradient).max() > 0


@pytest.mark.parametrize("fraction", [0.1, 0.4, 0.7, 0.95])
def test_pruning_by_groups_leaves_a_symmetric_network(fraction):
    _, config, tensors = network(28, 20)
    values = [np.random.default_rng(0).random(n) for n in (28, 20)]
    smaller, fewer = pruned(config, tensors, values, fraction)
    assert is_symmetric(fewer)
    assert smaller.encoding % 4 == smaller.hidden % 4 == 0
    least = 48 * (1 - fraction)
    assert smaller.encoding + smaller.hidden <= max(least, 16)
    assert smaller.encoding + smaller.hidden > least - 8
