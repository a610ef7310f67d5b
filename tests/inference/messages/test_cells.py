"""Occupancies of several grids, and which paths are cast for their messages."""

import weakref
from dataclasses import replace

import numpy as np
from filter_states import sighting, small

from gridslam.inference.beliefs.particles import Cloud, Sampling
from gridslam.inference.messages.cells import cast_at, casting_of
from gridslam.inference.workspace import cell_buffers


def test_occupancies_of_several_grids_are_kept_as_many_as_there_is_room_for(monkeypatch):
    from gridslam.kernels.propagation import occupancy

    monkeypatch.setattr(cell_buffers, "OCCUPANCY_BYTES", 3 * 8 * 16)
    plot, folds, fold_messages = small(), [], occupancy.fold_messages
    monkeypatch.setattr(
        occupancy, "fold_messages", lambda *given: folds.append(given[4]) or fold_messages(*given)
    )
    grids = [replace(plot.grid, evidence=np.full((4, 4), float(n))) for n in range(4)]
    first = [plot.cells.occupancy(grid).copy() for grid in grids[:3]]
    again = [plot.cells.occupancy(grid) for grid in grids[:3]]
    np.testing.assert_array_equal(first, again)
    assert folds == [1, 1, 1], "each was worked out once"
    plot.cells.occupancy(grids[3])
    plot.cells.occupancy(grids[1])
    assert len(folds) == 4
    np.testing.assert_array_equal(plot.cells.occupancy(grids[0]), first[0])
    assert len(folds) == 5, "there was no room for the one asked for longest ago"
    held = [weakref.ref(grid.evidence) for grid in grids]
    plot.state, grids = replace(plot.state, grid=grids[0]), grids[:1]
    plot.fold_messages()
    assert [ref() is None for ref in held[1:]] == [True] * 3, "it keeps no grid alive"


def test_grids_with_one_evidence_in_common_part_without_a_trace():
    plot, alone = small(), small()
    common = plot.state
    sighting(plot)
    plot.fold_messages()
    one, plot.state = plot.grid, common
    for each in (plot, alone):
        sighting(each, 0.2)
        each.fold_messages()
    np.testing.assert_array_equal(plot.grid.evidence, alone.grid.evidence)
    np.testing.assert_array_equal(plot.cells.occupancy(plot.grid), alone.cells.occupancy(alone.grid))
    assert (one.evidence != plot.grid.evidence).any()


def test_paths_too_unlikely_to_send_are_not_cast_with_the_messages():
    found = []
    for count in (1, 2):
        plot = small()
        likely, unlikely = [9.0, 1.0], [5.0, 0.0]
        path = np.array([[0, -1, -1, 0]] * count, np.int32)
        plot.work.messages.append(path, np.array([likely, unlikely])[:count], np.zeros((4, count)), (0, 1))
        cast, here = casting_of(len(plot.work.messages.path), 1, 0), np.array([[3.5, 3.5, 0.0]]).T
        cast.drawn[...] = np.nan
        cast_at(Sampling.at(Cloud(here, 0.0)), plot.grid, cast, np.array([[0.5, 0.5, 0.0, 0.0]]), plot.work)
        plot.fold_messages()
        found.append(plot.grid.evidence)
        assert np.isnan(cast.drawn[1:]).all()
        assert not cast.seen[1:count].any()
    np.testing.assert_array_equal(*found)
    assert found[0].any()
