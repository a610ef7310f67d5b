"""Mirrored worlds of direct SLAM: suspected where both sides of the anchors in sight fit."""

from dataclasses import replace

import numpy as np
import pytest
from delay_snapshots import BAND

import gridslam as gs
from gridslam.inference.health.signal_watch import SignalWatch
from gridslam.inference.management.samples.mirrored_places import bends, watch_mirrors
from gridslam.inference.state.samples.images import DirectState

SNR = 800.0


@pytest.fixture(scope="module")
def model():
    return gs.Scene.load("overlap").filter_model("agent1")


def state_at(model, offset, deviation, visible):
    """At an offset (2,) from anchor 0, known to deviations along x and y, with anchors so visible."""
    mean = np.concatenate([model.anchor_positions[0] + offset, np.zeros(2)])
    variance = np.concatenate([np.square(deviation), np.ones(2)])
    state = DirectState.start(mean, variance, 2, np.full(2, 0.5))
    return seen(state, visible)


def seen(state, visible, snr=SNR):
    links = replace(state.links, visible=np.array(visible), intensity=np.full(2, 0.5 * snr))
    return replace(state, links=links)


def test_bends_are_those_of_a_circle_in_deviations_of_its_distance(model):
    wide = state_at(model, [2.0, 0.0], [0.001, 0.3], [0.9, 0.1])
    sagitta = 0.3**2 / (2 * 2.0)
    deviation = 1 / (np.sqrt(2 * SNR) * BAND.rms_wavenumber)
    assert deviation == pytest.approx(0.01008, abs=1e-5)  # c / (sqrt(8) pi beta u) at 118 MHz
    np.testing.assert_allclose(bends(wide, BAND, model), [sagitta / deviation, 0.0])
    along = state_at(model, [2.0, 0.0], [0.3, 0.001], [0.9, 0.1])
    assert bends(along, BAND, model)[0] < 1e-4  # wide towards the anchor bends nothing
    crossing = replace(wide.belief, mean=wide.belief.mean + np.array([0.0, 0.0, 0.0, 1.1]))
    assert not bends(replace(wide, belief=crossing), BAND, model).any()  # the side is known by the velocity


def test_both_sides_remain_until_another_anchor_tells(model):
    narrow = state_at(model, [2.0, 0.0], [0.01, 0.02], [1.0, 0.0])
    assert watch_mirrors(narrow, BAND, model) is narrow
    wide = watch_mirrors(state_at(model, [2.0, 0.0], [0.01, 0.3], [1.0, 0.0]), BAND, model)
    assert wide.one_sided.tolist() == [1, 0]
    sure = replace(narrow, one_sided=wide.one_sided)  # one side was taken: that is no proof
    assert watch_mirrors(sure, BAND, model) is sure
    faint = seen(sure, [1.0, 0.999], snr=5.0)
    assert watch_mirrors(faint, BAND, model).one_sided.any()
    assert not watch_mirrors(seen(sure, [1.0, 0.999]), BAND, model).one_sided.any()
    # what told of the two sides in turn bears neither out
    both = watch_mirrors(replace(wide, links=seen(wide, [0.9, 0.9]).links), BAND, model)
    assert both.one_sided.tolist() == [1, 1]
    assert watch_mirrors(replace(sure, one_sided=both.one_sided), BAND, model).one_sided.any()


def test_an_anchor_whose_distance_was_vague_does_not_tell(model):
    """A reflection passes for a line of sight whose length is known worse than to c/B (0.75 m)."""
    for deviation, noted in ((0.7, [1, 0]), (0.8, [1, 1])):
        length = model.anchor_positions[1] - model.anchor_positions[0] - [0.0, 2.0]
        along = abs(length[0]) / np.hypot(*length)
        wide = state_at(model, [0.0, 2.0], [deviation / along, 0.001], [1.0, 0.0])
        found = watch_mirrors(wide, BAND, model)
        assert found.one_sided.tolist() == noted
        narrow = replace(state_at(model, [0.0, 2.0], [0.02, 0.01], [1.0, 0.999]), one_sided=found.one_sided)
        assert watch_mirrors(narrow, BAND, model).one_sided.any() == (noted[1] == 1)


def test_an_earlier_checkpoint_knows_no_side_and_goes_on(model):
    earlier = replace(state_at(model, [2.0, 0.0], [0.01, 0.3], [1.0, 0.0]), one_sided=np.zeros(0, np.int64))
    assert all(holds for _, holds, _ in earlier.claims(2))
    assert watch_mirrors(earlier, BAND, model).one_sided.tolist() == [1, 0]
    odd = replace(earlier, one_sided=np.zeros(3, np.int64))
    assert [part for part, holds, _ in odd.claims(2) if not holds] == ["one_sided"]


def test_health_says_that_a_mirrored_place_may_fit():
    assert SignalWatch().assess(0.1, 2).ok
    assert SignalWatch().assess(0.1, 2, mirrored=True).why.startswith("a mirrored place may fit as well")
