"""What an earlier agent was sure of is less sure to the next one, and isn't forgotten."""

import numpy as np
import pytest

from gridslam.inference.state.grid import CHANGED, EVIDENCE_CLIP, Grid
from gridslam.world.radio import BINS

TOLD = np.array([[-12.0, -2.0, 0.0, 0.5, 12.0]])


def inherited(evidence=TOLD):
    return Grid.inherited(evidence, evidence != 0, np.zeros((*evidence.shape, BINS), np.float32))


def test_an_inherited_cell_may_have_changed_since():
    occupied = 1 / (1 + np.exp(-TOLD))
    now = (1 - CHANGED) * occupied + CHANGED * (1 - occupied)
    np.testing.assert_allclose(inherited().evidence, np.log(now / (1 - now)), atol=1e-12)


def test_what_nothing_was_heard_of_is_handed_on_as_it_was():
    np.testing.assert_allclose(inherited().whole_evidence(), TOLD, atol=1e-12)
    np.testing.assert_allclose(inherited().whole_evidence((np.array([0]), np.array([4]))), [12.0])
    plain = Grid.of(TOLD, TOLD != 0, np.zeros((1, 5, BINS), np.float32))
    assert plain.whole_evidence() is plain.evidence or np.array_equal(plain.whole_evidence(), TOLD)


@pytest.mark.parametrize(("heard", "whole"), [(-1.0, 11.0), (-4.0, None), (9.0, EVIDENCE_CLIP)])
def test_the_earlier_map_counts_until_what_is_heard_outweighs_it(heard, whole):
    grid = inherited()
    own = grid.evidence + np.where(TOLD == 12.0, heard, 0.0)
    changed = Grid(own, grid.observed, grid.row, grid.hit, grid.withheld)
    expected = own[0, 4] if whole is None else whole
    assert changed.whole_evidence()[0, 4] == pytest.approx(expected)
    np.testing.assert_allclose(changed.whole_evidence()[0, :4], TOLD[0, :4], atol=1e-12)
