"""Direct SLAM: a line of sight that was away comes back where the agent drifted to; (M573)."""

import numpy as np
import pytest
from delay_snapshots import BAND, snapshot

from gridslam.inference.messages.samples.distance_mode import PathPrior
from gridslam.inference.messages.samples.image_births import birth_rate, find_births
from gridslam.inference.messages.samples.returning_paths import reach_of

RATE, SIGHT_M = birth_rate(100, 1), 6.0
pytestmark = pytest.mark.parametrize("seed", range(3))


def away(deviation, chance=0.01, *images):
    """A line of sight at 6 m that is hardly there, and images: distance, deviation, chance."""
    rows = np.array([(SIGHT_M, deviation, chance), *images])
    power = np.array([900.0] + [400.0] * len(images))
    mean, deviations, chances = np.ascontiguousarray(rows.T)
    return PathPrior(
        mean, np.diag(deviations**-2.0), power * chances, np.where(chances < 0.2, power, 0.0), chances
    )


def found(prior, seed, *paths):
    """What a snapshot of noise and paths (distance, amplitude) holds."""
    return find_births(BAND, snapshot(seed, *paths), prior, 1.0, RATE)


def new_of(all_found):
    return [new.distance for new in all_found.new if new.existence > 0.5]


@pytest.mark.parametrize("images", [(), ((9.0, 0.05, 0.9),)])
@pytest.mark.parametrize("off", [-2.5, -1.5, 1.5, 2.5])
def test_it_is_found_where_a_vague_agent_is(seed, off, images):
    there = SIGHT_M + off * 0.25
    one = found(away(0.25, 0.01, *images), seed, (there, 30.0), *((9.0, 20.0) for _ in images))
    assert (one.prior.away[0], one.prior.weight[0]) == (0.0, 900.0)
    assert one.mode.distance[0] == pytest.approx(there, abs=0.03)
    assert not new_of(one)


@pytest.mark.parametrize("chance", [0.01, 0.001])
@pytest.mark.parametrize("off", [-0.95, -0.8])
def test_from_another_sidelobe_too(seed, off, chance):
    one = found(away(0.35, chance), seed, (SIGHT_M + off, 30.0))
    assert one.mode.distance[0] == pytest.approx(SIGHT_M + off, abs=0.03)
    assert one.prior.away[0] == 0
    assert not one.new


def test_what_arrives_nearer_and_loud_is_it_however_vague_the_agent(seed):
    """Nothing arrives before a line of sight; where none is nearer, it may be a reflection."""
    nearer, farther = (found(away(0.42), seed, (SIGHT_M + off, 30.0)) for off in (-0.9, 0.9))
    assert nearer.mode.distance[0] == pytest.approx(SIGHT_M - 0.9, abs=0.05)
    assert farther.prior.away[0] == 900


@pytest.mark.parametrize(("deviation", "off"), [(0.25, 1.0), (0.6, 1.2), (1.5, -1.5), (0.6, 0.8)])
def test_nor_is_it_what_is_too_far_off_or_where_nothing_is(seed, deviation, off):
    one = found(away(deviation), seed, (SIGHT_M + off, 30.0))
    assert one.prior.weight[0] == pytest.approx(9.0) or abs(one.mode.distance[0] - SIGHT_M - off) < 0.1
    assert off < 0 or one.prior.away[0] == 900


@pytest.mark.parametrize(("deviation", "off", "amplitude"), [(0.3, -0.7, 7.0), (0.25, 0.68, 7.5)])
def test_a_faint_one_is_a_reflection_that_far_off(seed, deviation, off, amplitude):
    assert found(away(deviation, 1e-4), seed, (SIGHT_M + off, amplitude)).prior.away[0] == 900
    assert found(away(0.1, 1e-4), seed, (SIGHT_M + 0.15, 8.0)).prior.away[0] == 0, "near by, it isn't"


def test_a_faint_one_hides_no_new_path(seed):
    one = found(away(0.3, 1e-4), seed, (SIGHT_M - 0.7, 7.0), (12.0, 5.5))
    assert one.prior.away[0] == 900
    assert new_of(one) == pytest.approx([12.0], abs=0.1)


def test_two_paths_come_back_at_once_and_a_new_one_beside_it(seed):
    """The second one's search goes on from where that of the first has come to."""
    both = found(away(0.35, 0.01, (9.0, 0.05, 0.01)), seed, (5.1, 30.0), (9.02, 20.0))
    assert both.prior.away.tolist() == [0, 0]
    assert not both.new
    assert both.mode.distance == pytest.approx([5.1, 9.02], abs=0.05)
    beside = found(away(0.35), seed, (5.1, 30.0), (12.0, 10.0))
    assert beside.mode.distance[0] == pytest.approx(5.1, abs=0.05)
    assert new_of(beside) == pytest.approx([12.0], abs=0.1)


def test_images_come_back_near_by_alone(seed):
    one = found(away(0.25, 0.01, (9.0, 0.15, 0.001)), seed, (SIGHT_M, 30.0), (9.45, 20.0))
    assert one.prior.away[1] == 400
    assert new_of(one) == pytest.approx([9.45], abs=0.05)


def test_reach_by_hand(seed):
    """Deviations count whatever other paths do: one that is tied to an image's is as wide as before."""
    tied = np.linalg.inv(0.2**2 * np.array([[1.0, 0.99], [0.99, 1.0]]))
    prior = PathPrior(np.array([6.0, 9.0]), tied, np.ones(2), np.ones(2), np.ones(2))
    np.testing.assert_allclose(reach_of(prior, 0.75), [0.6, 0.3])
    np.testing.assert_allclose(reach_of(away(0.05), 0.75), [0.3])
    np.testing.assert_allclose(reach_of(away(0.374), 0.75), [1.122])
    np.testing.assert_allclose(reach_of(away(0.376), 0.75), [0.3])
