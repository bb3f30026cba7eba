import numpy as np
import pytest

from estimators.loihi.chip import (
    ANY,
    LIMITS,
    LoihiLayer,
    decay_profiles,
    distinct_profiles,
    partition,
    synaptic_bits,
)
from estimators.networks.decay_profiles import share_profiles
from estimators.networks.forward import OnLoihi
from estimators.networks.weights_file import load_network


def ones(out, inputs):
    return np.full((out, inputs), 2)


def test_every_neuron_has_one_place_and_every_core_fits():
    config, tensors = load_network("att-snn-paper")
    chip = OnLoihi(config, tensors)
    sizes = (config.encoding, config.hidden, 2)
    placed = [(k, i) for core in chip.cores for k, ids in core.neurons.items() for i in ids]
    assert sorted(placed) == [(k, i) for k, size in enumerate(sizes) for i in range(size)]
    assert all(core.used()[name] <= LIMITS[name] for core in chip.cores for name in LIMITS)


def test_more_than_32_profiles_take_another_core():
    for distinct, cores in ((32, 1), (33, 2), (64, 2), (65, 3)):
        layer = LoihiLayer(w_in=ones(100, 4), du=1 + np.arange(100) % distinct, dv=7)
        assert len(partition([layer])) == cores


def test_more_than_1024_compartments_take_another_core():
    layer = LoihiLayer(w_in=ones(1025, 0), dv=3)
    assert [len(core.neurons[0]) for core in partition([layer])] == [1024, 1]


def test_synaptic_memory_fills_cores():
    # 64 synapses of 8 + 9 bits and a head of 10 are 18 words of 64 bits.
    assert synaptic_bits(np.array([64, 0, 1]), 300) == 64 * (18 + 1)
    cores = partition([LoihiLayer(w_in=ones(300, 1000))])
    assert len(cores) > 300 * 1000 * 8 // LIMITS["synaptic bits"]
    assert all(core.used()["synaptic bits"] <= LIMITS["synaptic bits"] for core in cores)


def test_a_network_that_does_not_fit_is_refused_with_the_limit_and_the_excess(monkeypatch):
    with pytest.raises(ValueError, match="neuron 0 of layer 0: 5000 fan-in axons, a core has 4096: 904 too"):
        partition([LoihiLayer(w_in=ones(2, 5000))])
    below = LoihiLayer(w_in=ones(1024, 0), dv=3)
    with pytest.raises(ValueError, match=r"core 0: \d+ fan-out axons, a core has 4096: \d+ too many"):
        partition([below, LoihiLayer(w_in=ones(700, 1024))])
    monkeypatch.setitem(LIMITS, "compartments", 1)
    with pytest.raises(ValueError, match="the network needs 129 cores, a chip has 128: 1 too many"):
        partition([LoihiLayer(w_in=ones(129, 0), dv=3)])


def test_no_more_profiles_are_left_than_asked_for_and_32_fit_on_one_core():
    config, tensors = load_network("att-snn-paper")
    for profiles in (3, 32, 33):
        shared = OnLoihi(config, share_profiles(tensors, profiles))
        together = np.concatenate([decay_profiles(layer) for layer in shared.layers])
        assert len(np.unique(together, axis=0)) <= profiles
        assert len(shared.cores) == 1 or profiles > 32
    with pytest.raises(ValueError, match="profiles: 2, should be at least 3"):
        share_profiles(tensors, 2)


def test_profiles_with_a_decay_that_is_not_used_are_shared():
    assert distinct_profiles({(1, 2), (ANY, 2)}) == 1
    assert distinct_profiles({(ANY, 5), (ANY, 6), (1, 2)}) == 3
    assert distinct_profiles({(1, 2), (1, 3), (ANY, 3), (ANY, 9)}) == 3


def test_each_exponent_of_weights_is_a_format_with_lists_of_its_own():
    plain, mixed = (
        partition([LoihiLayer(w_in=ones(64, 3), exp_in=exponents)])[0].used()
        for exponents in (0, -(np.arange(64) % 4))
    )
    assert (plain["synaptic formats"], mixed["synaptic formats"]) == (1, 4)
    recurrent = LoihiLayer(w_in=ones(64, 3), w_rec=ones(64, 64), exp_rec=-(np.arange(64) % 3) - 1)
    assert partition([recurrent])[0].used()["synaptic formats"] == 4
    assert plain["fan-in axons"] == mixed["fan-in axons"] == 3
    # 3 axons with one list of 64 or four of 16 synapses of 8 + 6 bits, a head of 10, in words of 64 bits
    assert plain["synaptic bits"] == 3 * 64 * -(-(64 * 14 + 10) // 64)
    assert mixed["synaptic bits"] == 3 * 4 * 64 * -(-(16 * 14 + 10) // 64)
