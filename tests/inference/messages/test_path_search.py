"""The search that single antennas and arrays share: climbing to a mode, and taking in what is unexplained."""

from dataclasses import dataclass

import numpy as np
import pytest

from gridslam.inference.messages.samples.path_search import HALVINGS, climb, take_in


@dataclass
class Spot:
    value: float


class Bowl:
    """A posterior of one number, whose curvature is told wrongly by a factor."""

    def __init__(self, precision=1.0, longest=np.inf):
        self.precision, self.longest, self.seen = precision, longest, []

    def at(self, numbers):
        self.seen.append(float(numbers[0]))
        return Spot(-0.5 * float((numbers[0] - 3.0) ** 2))

    def slopes(self, numbers, place):
        return 3.0 - numbers, self.precision * np.eye(1)

    def shortened(self, place, step):
        return np.clip(step, -self.longest, self.longest)


@pytest.mark.parametrize("precision", [1.0, 0.1, 2.0])
def test_climbing_ends_at_the_mode_and_never_goes_down(precision):
    bowl, start = Bowl(precision), np.zeros(1)
    numbers, place = climb(bowl, start, bowl.at(start))
    assert numbers[0] == pytest.approx(3.0, abs=0.1)
    assert place.value == Bowl().at(numbers).value
    assert start[0] == 0.0


def test_a_step_is_no_longer_than_it_may_be():
    bowl = Bowl(longest=0.25)
    climb(bowl, np.zeros(1), bowl.at(np.zeros(1)))
    assert np.abs(np.diff(bowl.seen)).max() <= 0.25


def test_where_nothing_rises_the_search_stays():
    class Spike(Bowl):
        def at(self, numbers):
            self.seen.append(float(numbers[0]))
            return Spot(0.0 if numbers[0] == 0 else -1.0)

    spike = Spike()
    numbers, place = climb(spike, np.zeros(1), spike.at(np.zeros(1)))
    assert numbers[0] == 0.0
    assert place.value == 0.0
    assert len(spike.seen) == 1 + HALVINGS


class Hats:
    """Numbers stand for peaks; a prior is the tuple of those taken in, its mode their sum."""

    tries = 6

    def __init__(self, *peaks):
        self.left, self.aside = list(peaks), []

    def solve(self, prior):
        return sum(prior)

    def strongest(self, prior, mode):
        best = max(self.left, default=0)
        if best < 2:
            return None
        self.left.remove(best)
        return best

    def widened(self, prior, mode, peak):
        return None if peak == 7 else ((*prior, peak), sum(prior) + peak)  # 7 is known already

    def takes(self, prior, mode, trial, peak):
        assert (trial, sum(prior)) == (mode + peak, trial)
        if peak % 2:
            self.aside.append(peak)
        return peak % 2 == 0


def test_peaks_are_taken_in_strongest_first_until_none_is_worth_it():
    hats = Hats(4, 1, 7, 5, 8)
    assert take_in(hats, (1,)) == ((1, 8, 4), 13)
    assert (hats.aside, hats.left) == ([5], [1])


def test_no_more_peaks_are_looked_at_than_may_be():
    hats = Hats(*range(2, 40, 2))
    prior, _ = take_in(hats, ())
    assert len(prior) == Hats.tries
