from __future__ import annotations

import numpy as np

from stadimeter.simulation.camera import gaussian_pair, scramble

COUNT = 20_000


def test_the_same_keys_give_the_same_numbers() -> None:
    assert gaussian_pair(1, 2, 3) == gaussian_pair(1, 2, 3)


def test_every_key_and_their_order_count() -> None:
    assert len({scramble(*keys) for keys in ((1, 2), (2, 1), (1, 3), (0, 2), (1, 2, 0), (1,))}) == 6


def test_the_numbers_are_normally_distributed() -> None:
    numbers = np.array([gaussian_pair(7, index) for index in range(COUNT)]).ravel()
    assert abs(numbers.mean()) < 0.02
    assert abs(numbers.std() - 1) < 0.02
    assert abs((np.abs(numbers) < 1).mean() - 0.6827) < 0.01
    assert abs((np.abs(numbers) < 2).mean() - 0.9545) < 0.005


def test_neighbours_know_nothing_of_each_other() -> None:
    pairs = np.array([gaussian_pair(7, index) for index in range(COUNT)])
    assert abs(np.corrcoef(pairs[:, 0], pairs[:, 1])[0, 1]) < 0.03
    assert abs(np.corrcoef(pairs[:-1, 0], pairs[1:, 0])[0, 1]) < 0.03
