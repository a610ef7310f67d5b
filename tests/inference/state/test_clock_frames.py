"""Frames of clocks where agents' own are wide: joined by an anchor that two have set."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gridslam.inference.state.network.clock_frames import frames_joined, set_nowhere, within_priors
from gridslam.inference.state.network.clock_search import (
    CELL_M,
    FIRST_STEPS,
    NEVER,
    SET_VARIANCE,
    UNTIED_STEPS,
    ClockSearch,
)
from gridslam.world.clocks import ClockModel

CLOCKS = ClockModel(3, 3, np.array([0.0, 15.0, 15.0, 15.0, 0.5, 15.0]))
"""Anchor 0 is the time; agents 0 and 2 have wide clocks, agent 1 hasn't."""


def drawn(seed):
    """A search with anchors set at random, each frame's agents where the start put them."""
    draw, fresh = np.random.default_rng(seed), ClockSearch.start(CLOCKS)
    return replace(fresh, unset=fresh.unset & (draw.random(len(fresh.unset)) < 0.7))


def frames_of(search):
    return sorted({0, *search.frame.tolist()})


def test_rows_are_those_of_the_common_time_and_of_every_wide_clock():
    search = ClockSearch.start(CLOCKS)
    assert search.frame.tolist() == [1, 0, 3]
    assert search.unset.reshape(4, 3).tolist() == [[False, True, True], [True] * 3, [False] * 3, [True] * 3]
    reach = [(log > -1).sum() for log in search.log[[0, 1, 3, 4]]]
    assert reach == [1, 2 * round(15 / CELL_M) + 1, 2 * round(15 / CELL_M) + 1, 2 * round(30 / CELL_M) + 1]
    narrow = ClockSearch.start(ClockModel(2, 1, np.array([0.0, 15.0, 0.5])))
    assert not narrow.framed
    assert narrow.unset.tolist() == [False, True]


@given(seed=st.integers(0, 10_000))
@settings(max_examples=60, deadline=None)
def test_frames_that_an_anchor_ties_are_one_and_forget_nothing_that_is_set(seed):
    before = drawn(seed)
    after = frames_joined(before)
    frames = frames_of(after)
    for number, one in enumerate(frames):
        for other in frames[number + 1 :]:
            assert (after.unset[after.rows(one)] | after.unset[after.rows(other)]).all()
    for agent in range(3):
        assert not (after.open_to(agent) & ~before.open_to(agent)).any()
        assert after.frame_of(agent) <= before.frame_of(agent)
    np.testing.assert_array_equal(set_nowhere(before), set_nowhere(after))


def test_without_labels_the_first_anchors_that_are_set_bear_nothing_yet():
    search = ClockSearch.start(CLOCKS)
    own = search.rows(1)
    search = replace(search, unset=search.unset & ~np.isin(np.arange(12), [own.start + 1]))
    assert search.bearing(0, labelled=True).tolist() == [False, True, False]
    for steps, bears in ((FIRST_STEPS + 1, False), (UNTIED_STEPS, False), (UNTIED_STEPS + 1, True)):
        later = replace(search, since=np.full(12, steps))
        assert later.bearing(0, labelled=False).any() == bears
    assert search.main_frame == 0


def test_of_clocks_that_could_be_set_the_surest_of_each_frame_is():
    search = ClockSearch.start(CLOCKS)
    log = np.where(
        search.log > -1, np.array([0, 0, 0, -5, -9, -7, 0, 0, 0, -8, -3, -3.0])[:, None], search.log
    )
    found = [(3, 1.0), (4, 2.0), (5, 3.0), (9, 4.0), (10, 5.0)]
    assert sorted(replace(search, log=log).surest(found)) == [(4, 2.0), (9, 4.0)]
    again = replace(search, log=log).begun_anew(1)
    assert np.unique(again.log[4][search.log[4] > -1]).tolist() == [0.0]
    np.testing.assert_array_equal(again.log[9], log[9])


@pytest.mark.parametrize(("deviation", "wanted"), [(0.2, 4 * 0.04), (0.001, CELL_M**2), (2.0, SET_VARIANCE)])
def test_a_mode_is_told_with_four_times_the_variance_that_it_seems_to_have(deviation, wanted):
    search = ClockSearch.start(CLOCKS)
    log = search.log.copy()
    log[4] = -0.5 * (search.centre - 3.0) ** 2 / deviation**2
    assert replace(search, log=log).mode_variance(4, 3.0) == pytest.approx(wanted, rel=0.01)


def spans(search, mean, slack=0.0):
    """What is left of every row's offsets, from and to (m)."""
    narrowed = within_priors(search, CLOCKS.half_width_m, mean, np.full(len(mean), slack))
    return [search.centre[log > NEVER][[0, -1]] for log in narrowed.log]


def test_what_is_set_in_a_frame_bounds_the_offsets_of_others_by_the_priors_of_all():
    fresh = ClockSearch.start(CLOCKS)
    mean, unset = np.zeros(12), fresh.unset.copy()
    unset[4], mean[4] = False, 12.0  # anchor 1 in agent 0's frame: 15 m at most, so its clock is 3 at most
    search = replace(fresh, unset=unset)
    left = spans(search, mean)
    np.testing.assert_allclose(left[3], [-3.0, 15.0], atol=1.5 * CELL_M)  # anchor 0, whose clock is the time
    np.testing.assert_allclose(left[5], [-18.0, 30.0], atol=1.5 * CELL_M)
    np.testing.assert_allclose(left[1], [-3.0, 15.0], atol=1.5 * CELL_M)  # in the common time
    np.testing.assert_allclose(left[10], [-18.0, 30.0], atol=1.5 * CELL_M)  # and in agent 2's frame
    np.testing.assert_allclose(left[2], [-15.0, 15.0], atol=1.5 * CELL_M)
    np.testing.assert_allclose(spans(search, mean, slack=1.0)[3], [-4.0, 15.0], atol=1.5 * CELL_M)


def test_an_offset_that_is_set_in_the_common_time_bounds_it_in_the_frames_of_agents():
    fresh = ClockSearch.start(CLOCKS)
    mean, unset = np.zeros(12), fresh.unset.copy()
    unset[[1, 5]], mean[1], mean[5] = False, -10.0, 14.0  # agent 0's clock is 1 at most, by anchor 2
    left = spans(replace(fresh, unset=unset), mean)
    np.testing.assert_allclose(left[4], [-11.0, 5.0], atol=1.5 * CELL_M)
    np.testing.assert_allclose(left[10], [-25.0, 5.0], atol=1.5 * CELL_M)  # agent 2's clock is anything


def test_clocks_that_contradict_their_priors_rule_nothing_out():
    fresh = ClockSearch.start(CLOCKS)
    mean, unset = np.zeros(12), fresh.unset.copy()
    unset[[4, 5]], mean[4], mean[5] = False, 29.0, -29.0
    left = spans(replace(fresh, unset=unset), mean)
    np.testing.assert_allclose(left[3], [-15.0, 15.0], atol=1.5 * CELL_M)


@given(seed=st.integers(0, 10_000))
@settings(max_examples=60, deadline=None)
def test_what_clocks_truly_are_is_never_ruled_out(seed):
    draw, search = np.random.default_rng(seed), drawn(seed)
    true = draw.uniform(-1, 1, 6) * CLOCKS.half_width_m
    mean = (true[:3] - np.append(0.0, true[3:])[:, None]).ravel()
    for offset, (first, last) in zip(
        mean[search.unset], np.array(spans(search, mean))[search.unset], strict=True
    ):
        assert first - CELL_M <= offset <= last + CELL_M
