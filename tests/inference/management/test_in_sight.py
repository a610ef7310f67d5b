"""Walls that aren't seen from where the agent is stay as likely as they were."""

from dataclasses import replace

import numpy as np
import pytest
from filter_states import model_of, state_of

from gridslam.inference.beliefs.belief import Belief
from gridslam.inference.management.in_sight import DOUBTED, LASTING, spare_unseen

MODEL = model_of("room")


def believed(rays, sightings=LASTING, existence=0.9):
    """A state with a surface for each of the rays' existences, the only one over it that is believed in."""
    count = len(rays)
    mean = np.concatenate([np.zeros(5), np.tile([0.5, 2.0], count)])
    state = state_of(Belief(mean, 1e-4 * np.eye(len(mean))), existence=existence)
    bank = state.surfaces
    single = np.zeros_like(bank.single)
    single[0] = rays
    bank = replace(
        bank,
        seen=np.full(count, sightings),
        single=single,
        double=bank.double * 0,
        extent=np.tile([-1.0, 1.0], (count, 1)),
    )
    return replace(state, surfaces=bank)


def doubted(state, existence=0.5):
    return replace(state, surfaces=replace(state.surfaces, existence=np.full(len(state.surfaces), existence)))


def spared(earlier, state):
    return spare_unseen(earlier, state, MODEL).surfaces.existence


def test_silence_counts_of_rays_that_are_believed_in_alone():
    earlier = believed([0.0, DOUBTED - 0.01, 0.9])
    before = 0.9 / MODEL.settings.survival
    assert spared(earlier, doubted(earlier)) == pytest.approx([before, before, 0.5])


def test_what_was_heard_more_is_believed_in_more():
    earlier = believed([0.0])
    assert spared(earlier, doubted(earlier, 0.99)) == pytest.approx([0.99])


def test_ghosts_that_were_heard_now_and_then_are_not_spared_nor_what_was_born_since():
    few = believed([0.0], LASTING - 1)
    assert spared(few, doubted(few)) == pytest.approx([0.5])
    later = doubted(believed([0.0, 0.0]))
    assert spared(believed([0.0]), later)[1] == pytest.approx(0.5)


def test_beyond_an_occupied_wall_fresh_rays_count_for_nothing():
    state = believed([0.45])
    off = state.surfaces.extent + 50.0  # its stretch is far from where any bounce could be
    away = replace(state, surfaces=replace(state.surfaces, extent=off))
    assert spared(state, doubted(state)) == pytest.approx([0.5]), "in sight: it was missed"
    assert spared(away, doubted(away)) == pytest.approx([0.9 / MODEL.settings.survival])


def test_nothing_is_surer_than_sure():
    sure = believed([0.0], existence=1 - 1e-7)
    assert spared(sure, doubted(sure))[0] <= 1 - 1e-7
