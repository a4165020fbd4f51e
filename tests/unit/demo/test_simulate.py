"""The simulated drive is one a car could make, and the link keeps its books."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ufirext import UfirextError
from ufirext.demo.simulate import ACCELERATION, BRAKING, Link, city_drive, transmit

seeds = st.integers(0, 2**31)


@given(seeds)
def test_the_drive_has_858_points_at_one_hertz_by_default(seed: int) -> None:
    drive = city_drive(np.random.default_rng(seed))
    assert len(drive) == 858
    np.testing.assert_array_equal(drive.seconds, np.arange(858.0))
    assert drive.position.shape == (858, 2)


@given(seeds, st.floats(5.0, 20.0))
def test_the_car_keeps_to_its_speed_and_to_what_a_driver_bears(seed: int, speed: float) -> None:
    drive = city_drive(np.random.default_rng(seed), duration=300.0, dt=0.5, speed=speed)
    velocity = np.diff(drive.position, axis=0) / 0.5
    assert np.hypot(*velocity.T).max() <= 1.2 * speed + 1e-9
    acceleration = np.hypot(*np.diff(velocity, axis=0).T) / 0.5
    # the corner adds v^2/r = 4^2/8 m/s^2 across to braking or accelerating along
    assert acceleration.max() <= np.hypot(2.0, max(BRAKING, ACCELERATION)) + 0.3


@given(seeds)
def test_it_turns_at_right_angles_and_stops(seed: int) -> None:
    drive = city_drive(np.random.default_rng(seed), stops=0.6)
    velocity = np.diff(drive.position, axis=0)
    moving = np.hypot(*velocity.T) > 6.0  # faster than in any corner
    headings = np.arctan2(velocity[moving, 1], velocity[moving, 0])
    off_grid = (headings - headings[0] + np.pi / 4) % (np.pi / 2) - np.pi / 4
    straight = np.abs(off_grid) < 0.05
    assert straight.mean() > 0.9
    assert np.ptp(np.round((headings[straight] - headings[0]) / (np.pi / 2))) >= 1
    assert (np.hypot(*velocity.T) < 0.1).mean() > 0.03


def test_the_same_generator_state_gives_the_same_drive() -> None:
    first, second = (city_drive(np.random.default_rng(3)).position for _ in range(2))
    np.testing.assert_array_equal(first, second)
    assert not np.array_equal(first, city_drive(np.random.default_rng(4)).position)


@pytest.mark.parametrize("wrong", [{"duration": 0.0}, {"dt": -1.0}, {"speed": 0.0}, {"stops": 1.5}])
def test_impossible_drives_are_errors_that_name_the_argument(wrong: dict[str, float]) -> None:
    with pytest.raises(UfirextError, match=next(iter(wrong))):
        city_drive(np.random.default_rng(0), **wrong)


@given(seeds, st.floats(0, 1), st.floats(0, 1), st.integers(1, 9))
def test_every_packet_arrives_at_most_once_and_never_early(
    seed: int, loss: float, late: float, longest: int
) -> None:
    arrivals = transmit(np.random.default_rng(seed), 200, Link(loss, late, longest))
    origins = [origin for packets in arrivals for origin, _ in packets]
    assert len(set(origins)) == len(origins)
    for step, packets in enumerate(arrivals):
        assert packets == sorted(packets)
        assert all(origin + delay == step and 0 <= delay <= longest for origin, delay in packets)


def test_a_perfect_link_delivers_everything_at_once() -> None:
    assert transmit(np.random.default_rng(0), 50, Link()) == [[(n, 0)] for n in range(50)]


def test_losses_and_delays_are_as_frequent_as_asked() -> None:
    count = 20_000
    arrivals = transmit(np.random.default_rng(0), count, Link(loss=0.1, late=0.4, longest=3))
    delays = np.array([delay for packets in arrivals for _, delay in packets])
    for share, chance in (
        (len(delays) / count, 0.9),
        *(((delays == d).mean(), p) for d, p in enumerate((0.6, 0.4 / 3, 0.4 / 3, 0.4 / 3))),
    ):
        assert abs(share - chance) < 5 * np.sqrt(chance * (1 - chance) / len(delays))


@pytest.mark.parametrize("link", [Link(loss=-0.1), Link(late=1.1, longest=1), Link(late=0.5)])
def test_impossible_links_are_errors(link: Link) -> None:
    with pytest.raises(UfirextError):
        transmit(np.random.default_rng(0), 10, link)
