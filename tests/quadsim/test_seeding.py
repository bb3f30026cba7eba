import numpy as np
import pytest

from quadsim.seeding import child, vehicle_seeds


def state(seed: np.random.SeedSequence) -> list[int]:
    return seed.generate_state(4).tolist()


def test_children_are_those_of_spawn():
    spawned = np.random.SeedSequence(7).spawn(3)[2].spawn(2)[1]
    parent = np.random.SeedSequence(7)
    for _ in range(2):
        assert state(child(parent, 2, 1)) == state(spawned)
    assert parent.n_children_spawned == 0


@pytest.mark.parametrize("n", [1, 7])
def test_seed_of_a_vehicle_does_not_depend_on_their_number(n):
    many = [state(seed) for seed in vehicle_seeds(3, 9)]
    assert [state(seed) for seed in vehicle_seeds(3, n)] == many[:n]
    assert len({tuple(each) for each in many}) == 9


def test_kinds_of_seed_agree():
    expected = [state(seed) for seed in vehicle_seeds(3, 2)]
    assert [state(seed) for seed in vehicle_seeds(np.int64(3), 2)] == expected
    assert [state(seed) for seed in vehicle_seeds(np.random.SeedSequence(3), 2)] == expected
    assert [state(seed) for seed in vehicle_seeds(np.random.SeedSequence(3).spawn(2), 2)] == expected


@pytest.mark.parametrize(
    ("seed", "message"),
    [
        (-1, "seed is -1; it must be a whole number from 0 up"),
        (1.5, "seed is 1.5"),
        (None, "seed is None"),
        ([1, 2], r"seed is \[1, 2\]"),
        (np.random.SeedSequence(0).spawn(3), "3 seeds for 2 vehicles"),
    ],
)
def test_bad_seeds_are_refused(seed, message):
    with pytest.raises(ValueError, match=message):
        vehicle_seeds(seed, 2)
