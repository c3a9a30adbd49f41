"""FeedProfile against closed forms, its own limits, and the envelope that no admissible speed can exceed."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pkm_cnc.motion import Cell, FeedProfile, speeds_squared

lengths_and_feeds = st.lists(
    st.tuples(
        st.floats(-6.0, 0.0).map(lambda exponent: 10.0**exponent),
        st.floats(-4.0, 1.0).map(lambda exponent: 10.0**exponent),
    ),
    min_size=1,
    max_size=8,
).map(lambda pairs: ([length for length, _ in pairs], [feed for _, feed in pairs]))
accelerations = st.floats(0.1, 20.0)
robust = settings(derandomize=True, deadline=None, max_examples=60)


def planned(lengths: list[float], feeds: list[float], acceleration: float) -> FeedProfile:
    """From rest to rest over elements that only feeds and the path's acceleration limit."""
    cells = [Cell(length, feed * feed, ((0.0, acceleration),)) for length, feed in zip(lengths, feeds, strict=True)]
    limits = [cell.limit for cell in cells]
    squares, held = speeds_squared(cells, [limits[0], *map(min, itertools.pairwise(limits)), limits[-1]], 0.0, 0.0)
    assert held
    return FeedProfile(cells, squares)


def at(profile: FeedProfile, t: float) -> tuple[int, float, float, float]:
    """Element, path length from its start, v and a at one time."""
    element, s, v, a = (column.item() for column in profile.at(np.array([t])))
    return element, s, v, a


def sampled(profile: FeedProfile, lengths: list[float], times: list[float]) -> np.ndarray:
    """Element, path length over the whole run, v and a at the times, one row each."""
    starts = [0.0, *itertools.accumulate(lengths)]
    return np.array([(e, starts[e] + s, v, a) for e, s, v, a in zip(*profile.at(np.asarray(times)), strict=True)])


def envelope(lengths: list[float], feeds: list[float], acceleration: float, s: np.ndarray) -> np.ndarray:
    """The largest v(s) from rest to rest: every limit, a feed or a rest, reaches along s by v^2 + 2 a distance."""
    edges = np.array([0.0, *itertools.accumulate(lengths)])
    square = 2.0 * acceleration * np.minimum(s, edges[-1] - s)
    for begin, end, feed in zip(edges[:-1], edges[1:], feeds, strict=True):
        distance = np.maximum(np.maximum(begin - s, s - end), 0.0)
        square = np.minimum(square, feed**2 + 2.0 * acceleration * distance)
    return np.sqrt(np.maximum(square, 0.0))


def test_a_long_element_is_a_trapezoid() -> None:
    length, feed, acceleration = 0.2, 0.1, 2.0
    profile = planned([length], [feed], acceleration)
    ramp = feed / acceleration
    assert profile.duration == pytest.approx(length / feed + ramp, rel=1e-14)
    assert at(profile, 0.0) == (0, 0.0, 0.0, acceleration)
    assert at(profile, 0.03) == pytest.approx((0, 0.5 * 2.0 * 0.03**2, 0.06, 2.0), rel=1e-14)
    assert at(profile, 1.0) == pytest.approx((0, 0.5 * feed * ramp + feed * (1.0 - ramp), feed, 0.0), rel=1e-14)
    left = 0.02
    late = (0, length - 0.5 * acceleration * left**2, acceleration * left, -acceleration)
    assert at(profile, profile.duration - left) == pytest.approx(late, rel=1e-12)


def test_a_short_element_is_a_triangle_that_misses_its_feed() -> None:
    profile = planned([1e-3], [0.1], 2.0)
    half = math.sqrt(1e-3 / 2.0)
    assert profile.duration == pytest.approx(2.0 * half, rel=1e-14)
    assert at(profile, half)[1:3] == pytest.approx((0.5e-3, 2.0 * half), rel=1e-12)


@pytest.mark.parametrize("feeds", [[0.05, 0.2], [0.2, 0.05]])
def test_the_change_of_feed_is_made_in_the_faster_element(feeds: list[float]) -> None:
    length, acceleration, slow, fast = 0.3, 2.0, 0.05, 0.2
    profile = planned([length, length], feeds, acceleration)
    slow_time = slow / acceleration + (length - slow**2 / (2.0 * acceleration)) / slow
    ramps = (fast - slow) / acceleration + fast / acceleration
    ramp_lengths = (fast**2 - slow**2) / (2.0 * acceleration) + fast**2 / (2.0 * acceleration)
    fast_time = ramps + (length - ramp_lengths) / fast
    assert profile.duration == pytest.approx(slow_time + fast_time, rel=1e-13)
    junction = slow_time if feeds[0] == slow else fast_time
    element, _, v, _ = at(profile, junction + 1e-9)
    assert (element, v) == (1, pytest.approx(slow, rel=1e-6))


@pytest.mark.parametrize("beyond", [0.0, 1e-9, 1.0, 1e9])
def test_from_its_end_on_it_rests_exactly_at_the_end(beyond: float) -> None:
    lengths = [0.1, 0.3, 0.7 / 3.0]
    profile = planned(lengths, [0.1, 0.03, 0.2], 1.7)
    assert at(profile, profile.duration + beyond) == (2, lengths[-1], 0.0, 0.0)


@robust
@given(lengths_and_feeds, accelerations)
def test_limits_hold_and_speed_is_the_derivative_of_path_length(
    run: tuple[list[float], list[float]], acceleration: float
) -> None:
    lengths, feeds = run
    profile = planned(lengths, feeds, acceleration)
    times = np.linspace(0.0, profile.duration, 2001)
    e, s, v, a = sampled(profile, lengths, times.tolist()).T
    total = sum(lengths)
    dt, ds, dv = np.diff(times), np.diff(s), np.diff(v)
    assert np.all(v >= 0.0)
    assert np.all(v <= np.array(feeds)[e.astype(int)] * (1.0 + 1e-12))
    assert np.all(np.abs(a) <= acceleration)
    assert np.all(np.abs(dv) <= acceleration * dt * (1.0 + 1e-9) + 1e-14 * max(feeds))
    assert np.all(np.diff(e) >= 0)
    assert np.all(ds >= -1e-15 * total)
    assert s[-1] == pytest.approx(total, rel=1e-15)
    # the trapezoidal rule errs by a dt^2 / 4 at most where |dv/dt| <= a
    assert np.all(
        np.abs(ds - 0.5 * (v[1:] + v[:-1]) * dt) <= 0.25 * acceleration * dt**2 * (1.0 + 1e-9) + 1e-14 * total
    )


@robust
@given(lengths_and_feeds, accelerations)
def test_no_admissible_speed_is_larger_anywhere(run: tuple[list[float], list[float]], acceleration: float) -> None:
    lengths, feeds = run
    profile = planned(lengths, feeds, acceleration)
    times = np.linspace(0.0, profile.duration, 2001)
    _, s, v, _ = sampled(profile, lengths, times.tolist()).T
    rounding = 4.0 * acceleration * 1e-15 * sum(lengths)
    np.testing.assert_allclose(v**2, envelope(lengths, feeds, acceleration, s) ** 2, rtol=1e-9, atol=rounding)


@robust
@given(lengths_and_feeds, accelerations)
def test_duration_is_that_of_a_phase_plane_integration(
    run: tuple[list[float], list[float]], acceleration: float
) -> None:
    lengths, feeds = run
    cells = 2000
    edges = [0.0, *itertools.accumulate(lengths)]
    grids = [np.linspace(begin, end, cells + 1) for begin, end in itertools.pairwise(edges)]
    grid = np.concatenate([grids[0], *(part[1:] for part in grids[1:])])
    ds = np.diff(grid)
    nodes = [0.0, *(np.minimum(a, b) ** 2 for a, b in itertools.pairwise(np.repeat(feeds, cells).tolist())), 0.0]
    for k in range(len(ds)):
        nodes[k + 1] = min(nodes[k + 1], nodes[k] + 2.0 * acceleration * ds[k])
    for k in reversed(range(len(ds))):
        nodes[k] = min(nodes[k], nodes[k + 1] + 2.0 * acceleration * ds[k])
    v = np.sqrt(nodes)
    integrated = float(np.sum(2.0 * ds / (v[1:] + v[:-1])))
    # Constant acceleration in every cell is admissible, so it cannot be faster; and it can lose no more than the time
    # of the cells in which the acceleration switches, at most three of an element and each below twice its mean.
    duration = planned(lengths, feeds, acceleration).duration
    assert integrated * (1.0 - 8.0 / cells) <= duration <= integrated * (1.0 + 1e-9)


@pytest.mark.parametrize("count", [100, 100_000])
def test_many_short_elements_are_as_fast_as_one(count: int) -> None:
    profile = planned([1e-5] * count, [0.1] * count, 2.0)
    whole = planned([1e-5 * count], [0.1], 2.0)
    assert profile.duration == pytest.approx(whole.duration, rel=1e-13)
    for t in (0.1 * whole.duration, 0.6 * whole.duration, 0.99 * whole.duration):
        element, s, v, a = at(profile, t)
        _, whole_s, whole_v, whole_a = at(whole, t)
        assert (1e-5 * element + s, v, a) == pytest.approx((whole_s, whole_v, whole_a), rel=1e-12)


def around(t: float, ulps: int = 8) -> list[float]:
    """The doubles around t."""
    times = [t]
    for direction in (-math.inf, math.inf):
        neighbour = t
        for _ in range(ulps):
            neighbour = math.nextafter(neighbour, direction)
            times.append(neighbour)
    return sorted(times)


def test_while_speeding_up_over_short_elements_the_acceleration_never_flickers() -> None:
    count, acceleration = 240, 2.0  # 2.4 mm of the 2.5 mm that the feed needs
    profile = planned([1e-5] * 1000, [0.1] * 1000, acceleration)
    for junction in range(1, count):
        for t in around(math.sqrt(2.0 * 1e-5 * junction / acceleration)):
            assert at(profile, t)[3] == acceleration
            assert at(profile, profile.duration - t)[3] == -acceleration


@robust
@given(lengths_and_feeds, accelerations)
def test_rounding_leaves_neither_the_element_nor_the_sense_of_travel(
    run: tuple[list[float], list[float]], acceleration: float
) -> None:
    lengths, feeds = run
    profile = planned(lengths, feeds, acceleration)
    for t in [0.0, *around(profile.duration)]:
        element, s, v, _ = at(profile, t)
        assert 0.0 <= s <= lengths[element]
        assert v >= 0.0
    for element in range(1, len(lengths)):  # bisect for the time of each junction
        low, high = 0.0, profile.duration
        while math.nextafter(low, high) < high:
            middle = 0.5 * (low + high)
            low, high = (middle, high) if at(profile, middle)[0] < element else (low, middle)
        assert at(profile, low)[1] <= lengths[at(profile, low)[0]]
        assert at(profile, high)[1] >= 0.0


def test_a_slow_element_among_many_fast_ones_is_seen_from_afar() -> None:
    lengths, feeds = [1e-5] * 2001, [0.1] * 2001
    feeds[1000] = 1e-3
    profile = planned(lengths, feeds, 2.0)
    _, s, v, _ = sampled(profile, lengths, np.linspace(0.0, profile.duration, 5001).tolist()).T
    np.testing.assert_allclose(v, envelope(lengths, feeds, 2.0, s), rtol=1e-8, atol=1e-8)
    assert v.max() == pytest.approx(0.1)
