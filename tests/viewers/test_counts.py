"""Numbers in figures are those in tables."""

import pytest

import gridslam as gs
from gridslam.evaluation.surface_truth import AudibleSurfaces
from gridslam.viewers.plots import _seen_so_far


@pytest.mark.slow
def test_true_surfaces_over_the_steps_end_at_the_number_in_the_table():
    """`facade` has a curved wall of many facets, which counts once."""
    scene = gs.Scene.load("facade")
    truth = gs.ground_truth(scene, "agent1").first(60)
    counts = _seen_so_far(truth, [], 60)
    assert counts[-1] == AudibleSurfaces.of(truth).count()
    assert counts == sorted(counts)
    hit = truth.paths.segment[truth.paths.segment >= 0]
    assert counts[-1] < len(set(truth.segments.surface[hit].tolist()))
    later = truth.first(1)
    assert _seen_so_far(later, [truth], 1) == [AudibleSurfaces.of(later.joined([truth])).count()]
