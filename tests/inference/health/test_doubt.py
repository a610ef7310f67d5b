"""Doubt about all hypotheses, by hand: what a fresh start explains better, and what bears out a start."""

import numpy as np
import pytest

from gridslam.inference.health.doubt import (
    BY_CHANCE,
    DOUBT_STEPS,
    FADING,
    ONE_ALONE,
    ONE_UNEXPLAINED,
    PROOF_LEAD,
    PROOF_LOUD,
    SURPLUS,
    TOLD_BY_SIGHT,
    Doubt,
    places,
)
from gridslam.inference.health.reasons import UNPROVEN


def test_what_is_hardly_explained_counts_for_more_by_hand():
    well, badly = (Doubt().compared(worth, 30.0, 12.0, 0.0, 2.0) for worth in (20.0, 19.9))
    assert Doubt().compared(20.0, 30.0, 12.0, 0.0, 2.0, False).elsewhere == 0.0, "every tenth step is asked"
    assert (well.elsewhere, badly.elsewhere) == (30 - 12 - ONE_ALONE, 30 - 12 - ONE_UNEXPLAINED)
    assert (well.raised, badly.raised) == (False, True)
    assert not Doubt().is_urgent(0.0, 0.0)
    assert badly.is_urgent(1e3, 1.0), "until the place isn't called wrong any more"
    later = badly.followed(0.0, 1)
    assert (later.raised, later.doubtful) == (False, DOUBT_STEPS - 1)
    again = later.compared(0.0, 30.0, 12.0, 0.0, 2.0, False)
    assert again.elsewhere == FADING * badly.elsewhere + 30 - 12 - ONE_UNEXPLAINED
    assert not again.raised, "it was called wrong before"
    assert not badly.compared(1e3, 12.0, 12.0, 0.0, 2.0, False).reasons(), "found again, it is well at once"
    assert Doubt().compared(0.0, 1.5, 0.0, 0.0, 9.0).raised, "a low lead is a doubt, too"
    assert not Doubt().compared(0.0, 1.5, 0.6, 0.0, 9.0).raised, "searches differ by as much"
    assert not Doubt().compared(0.0, 1.0, 1.0, 0.0, 9.0).raised, "where it stands is the believed place"


def test_what_one_mirror_may_show_does_not_count_by_hand():
    both = Doubt().compared(1e3, 40.0, 0.0, 18.0, 2.0)
    assert both.elsewhere == 40.0 - 18.0 - ONE_ALONE
    assert Doubt().scored(40.0, 0.0, 18.0).elsewhere == both.elsewhere


def test_steps_that_fit_better_elsewhere_add_up_by_hand():
    """Each says too little by itself; one that is explained at the believed place takes from the sum."""
    evidence, better = 45.0, BY_CHANCE + 0.4 * SURPLUS
    doubt = Doubt()
    for count in (1, 2):
        doubt = doubt.compared(evidence, evidence + better, evidence, 0.0, 2.0, False)
        assert doubt.surplus == pytest.approx(0.4 * SURPLUS * count)
        assert not doubt.reasons()
        assert doubt.is_urgent(1e3, 1.0), "until the sum is gone"
    third = doubt.compared(evidence, evidence + better, evidence, 0.0, 2.0, False)
    assert third.raised
    assert "fits another place better, by 18 nats" in third.reasons()[0]
    here = doubt.compared(evidence, evidence + better, evidence + better, 0.0, 2.0, False)
    assert here.surplus == doubt.surplus, "a fresh start that stands at the believed place is no rival"
    lower = third.compared(evidence, evidence - 1.0, evidence - 1.0, 0.0, 2.0, False)
    assert lower.surplus == pytest.approx(third.surplus - BY_CHANCE - 1.0)
    assert third.compared(evidence, 10.0, 10.0, 0.0, 2.0, False).surplus == 0.0


def test_places_are_hypotheses_that_count_and_stand_apart():
    """Three hypotheses, of which the first two stand together, and one too unlikely to count."""
    at = np.array([0.0, 0.01, 5.0, 9.0])
    near = np.abs(at[:, None] - at) < 1
    for least, count in ((0.9e-4, 2), (1.1e-4, 3)):
        log = np.log([0.5, 0.3, 0.2 - least, least])
        assert places(log, lambda rows: near[np.ix_(rows, rows)]) == count
    assert places(log[:1], lambda rows: pytest.fail("one hypothesis is at one place")) == 1


def test_a_start_of_too_many_places_is_borne_out_by_evidence_alone():
    doubt = Doubt(unproven=True)
    assert doubt.reasons() == [UNPROVEN]
    assert doubt.followed(0.0, 1).doubtful == DOUBT_STEPS, "other places are looked for meanwhile"
    enough = PROOF_LEAD * PROOF_LOUD
    assert doubt.tried(enough - 1, 3).reasons() == [UNPROVEN]
    assert doubt.tried(enough - 1, 3).tried(2.0, 1).reasons() == []
    crowd = int(2 * PROOF_LOUD)
    assert doubt.tried(enough + 1, crowd).unproven, "each loud measurement has to say it"
    assert not doubt.tried(PROOF_LEAD * crowd, crowd).unproven
    assert Doubt(turnable=True).compared(1e3, 0.0, 0.0, 0.0, 9).doubtful == 0, "no other place would tell"
    against = doubt.tried(enough - 1, 3).tried(-enough, 2)
    assert (against.borne, against.counted, against.unproven) == (0.0, 0.0, True)
    assert against.tried(enough - 1, 2).unproven, "what was said before is gone"
    sighted = doubt.tried(-1.0, 1, TOLD_BY_SIGHT - 1)
    assert sighted.unproven
    assert not sighted.tried(-1.0, 1, 1.0).unproven, "lines of sight tell the place, though nothing is mapped"
    fainter = sighted.tried(-1.0, 1, -2 * TOLD_BY_SIGHT)
    assert fainter.sighted == 0.0
    assert fainter.tried(-1.0, 1, TOLD_BY_SIGHT - 1).unproven
