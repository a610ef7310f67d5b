"""What a snapshot alone says of its paths, and of which single bounces it says anything."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from array_snapshots import band_of, snapshot

import gridslam as gs
from gridslam.inference.beliefs.belief import Belief
from gridslam.inference.messages.samples.heard_bounces import HeardBounces, measured, weigh_forms
from gridslam.inference.messages.samples.state_mode import PathsPrior, paths_at, state_mode
from gridslam.inference.state.rays import Rays
from gridslam.inference.state.state import State
from gridslam.inference.state.surface_bank import SurfaceBank
from gridslam.kernels import UNMEASURED

MEAN = np.array([0.5, -0.4, 0.1, 0.0, 0.3, 0.1, 3.0, 1.6, 2.5])
"""Agent, and two walls."""
PLACE = np.array([-2.0, 1.0, 0.2])
TABLE = np.array([[0, -1, -1, 0], [1, 0, -1, 0], [1, 1, -1, 0], [2, 0, 1, 0]], np.int32)
BAND = band_of(3, 3, 31)
DEVIATION = np.array([0.05, 0.05, 0.01, 0.01, 0.05, 0.02, 0.05, 0.02, 0.05])
OFF = np.array([0.02, -0.02, 0.0, 0.0, 0.02, 0.01, -0.02, 0.01, 0.02])
"""By how much the state is another than believed."""


def mode_at(truth, mean=MEAN, band=BAND, loud=30.0, believed=1e-3, table=TABLE, seed=0):
    """The mode of a state that is believed to be elsewhere, for sure."""
    turned = np.exp(2j * np.pi * np.random.default_rng(seed).uniform(size=len(table)))
    samples = snapshot(band, paths_at(truth, PLACE, table, 5)[0], loud * turned, 1.0, seed)
    belief = Belief(mean.copy(), believed**2 * np.eye(len(mean)))
    prior = PathsPrior(belief, PLACE, table, np.full(len(table), loud**2), np.zeros((0, 3)))
    return state_mode(band, samples, prior, 1.0)


def test_what_a_snapshot_says_is_of_the_world_and_not_of_the_belief_and_as_sure_as_it_claims():
    truth, misses = MEAN + OFF, []
    wanted, believed = (paths_at(state, PLACE, TABLE, 5)[0] for state in (truth, MEAN))
    for seed in range(40):
        mode = mode_at(truth, seed=seed)
        value, variance = measured(mode)
        assert np.abs(mode.path - believed).max() < 0.3 * np.abs(wanted - believed).max()
        misses.append((value - wanted) / np.sqrt(variance))
    misses = np.array(misses)
    assert np.abs(misses.mean(0)).max() < 0.6  # 0.16 by chance; the step is one, not the last
    assert 0.7 < (misses**2).mean() < 1.4
    assert np.abs((wanted - believed) / np.sqrt(variance)).max() > 4


def test_a_lone_path_is_known_as_its_radio_allows():
    """By hand: of SNR u^2, 1 / (2 u^2 b^2), b the root mean square slope of the phase."""
    _, variance = measured(mode_at(MEAN, table=TABLE[:1], loud=30.0))
    power, steps = np.hanning(33)[1:-1] ** 2, np.arange(31) - 15
    slope = 2 * np.pi * 2.5e7 / 299_792_458 * np.sqrt((power * steps**2).sum() / power.sum())
    assert np.sqrt(variance[0, 0]) == pytest.approx(1 / (np.sqrt(2) * 30 * slope), rel=0.05)


def test_paths_that_overlap_are_vague():
    close, walls = MEAN.copy(), TABLE[1:3]
    close[[7, 8]] = close[[5, 6]] + [0.02, 0.05]
    apart, beside = (measured(mode_at(state, state, table=walls))[1] for state in (MEAN, close))
    assert (beside[:, 0] > 10 * apart[:, 0]).all()


def test_an_antenna_without_extent_measures_no_departure():
    band = replace(BAND, anchor=np.zeros((1, 2)))
    value, variance = measured(mode_at(MEAN + OFF, band=band))
    assert (variance[:, 1] == UNMEASURED).all()
    assert (variance[:, [0, 2]] < 1).all()
    assert np.isfinite(value).all()


def heard_of(mode, squared, followed=range(4), own=2.0, weight=900.0, band=BAND):
    """What stands out where paths' squared amplitudes are as given."""
    count = len(followed)
    likelihood = SimpleNamespace(
        followed=np.array(followed), matched=own * np.array(squared), own=np.full(4, own),
        found=SimpleNamespace(mode=mode, prior=SimpleNamespace(weight=np.full(count, weight))),
    )  # fmt: skip
    rays = Rays(TABLE, np.ones(4), np.ones(4), (2, 1))
    return HeardBounces.of(SimpleNamespace(rays=rays, band=band, noise=1.0), likelihood)


def test_only_single_bounces_that_stand_out_count():
    mode = mode_at(MEAN)
    heard = heard_of(mode, [900.0] * 4)
    assert heard.row.tolist() == [1, 2]
    assert heard.surface.tolist() == [0, 1]
    np.testing.assert_array_equal(heard.rows, np.hstack(measured(mode))[1:3])
    assert heard_of(mode, [900.0, 7.0, 5.0, 900.0]).surface.tolist() == [0]
    assert len(heard_of(mode, [900.0, 5.0, 5.0, 900.0]).row) == 0


def test_nor_do_those_that_another_path_is_beside_which_matters():
    """0.1 m apart they share what is heard, and claim too much."""
    close = MEAN.copy()
    close[[7, 8]] = close[[5, 6]] + [0.02, 0.05]
    mode = mode_at(close, close)
    assert len(heard_of(mode, [900.0] * 4).row) == 0
    assert heard_of(mode, [900.0] * 4, weight=0.5).row.tolist() == [1, 2]


def test_angles_are_those_that_right_arrays_would_have_measured():
    mode = mode_at(MEAN)
    turned = np.zeros_like(mode.path)
    turned[:, 1:] = 0.02
    (right, variance), (found, same) = measured(mode), measured(replace(mode, turned=turned))
    np.testing.assert_allclose(found, right - turned)
    np.testing.assert_array_equal(same, variance)


def test_rows_are_those_of_the_snapshot_where_not_all_paths_are_followed():
    mode = mode_at(MEAN)
    shorter = replace(
        mode, path=mode.path[1:], turned=mode.turned[1:], paths=replace(
            mode.paths, gradient=mode.paths.gradient[1:], information=mode.paths.information[3:, 3:]
        ),
    )  # fmt: skip
    heard = heard_of(shorter, [0.0, 5.0, 900.0, 900.0], followed=[1, 2, 3])
    assert heard.row.tolist() == [2]
    np.testing.assert_array_equal(heard.rows, np.hstack(measured(shorter))[1:2])


def state_of(owner=(-1, -1), astray=False):
    bank = SurfaceBank.empty(1)
    for number in range(2):
        bank = bank.add(number, 1.0, np.full(20, 0.05), 0.0, (0, -1, -1), owner[number])
    state = State.start(gs.Scene.load("chamber").filter_model())
    monitor = replace(state.monitor, lost=5) if astray else state.monitor
    return replace(state, belief=Belief(MEAN.copy(), np.diag(DEVIATION**2)), surfaces=bank, monitor=monitor)


def test_forms_are_fitted_of_shared_surfaces_alone_and_not_while_lost():
    model = SimpleNamespace(places=np.array([[*PLACE, 0.0]]))
    heard = heard_of(mode_at(MEAN), [900.0] * 4)

    def fitted(**known):
        return weigh_forms(state_of(**known), heard, model).surfaces.forms.any(1).tolist()

    assert fitted() == [True, True]
    assert fitted(owner=(0, -1)) == [False, True]
    assert fitted(astray=True) == [False, False]
