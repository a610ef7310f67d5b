"""What `check` weighs rows by, against numbers worked out by hand; and rows in any order within a step."""

import numpy as np
import pytest

import gridslam as gs
from gridslam.checks.sights.likelihood import ANGLE_STD, LEAST_DISTANCE_STD_M, rows_of
from gridslam.checks.sights.line_of_sight_filter import explain
from gridslam.kernels.primitives.sights import PEAK, SURE, VALUES

SCENE = gs.Scene.load("room")
NAMES = ("step", "anchor", "distance_m", "aod_rad", "aoa_rad")


def rows():
    """Two rows: distances of 4 and 6 m, so evenly 0.5 per metre; no angle in the second."""
    columns = {"step": [0, 0], "anchor": [0, 0], "distance_m": [4.0, 6.0], "aoa_rad": [3.0, np.nan]}
    return rows_of({name: np.array(values) for name, values in columns.items()}, SCENE)


def test_the_ratio_at_best_is_that_of_normal_densities_over_how_dense_the_column_lies():
    sigma = 1 / rows()[0, SURE]
    assert sigma == pytest.approx(max(LEAST_DISTANCE_STD_M, 0.5 * 299792458 / SCENE.radio.bandwidth_hz))
    lengths = 1 / (np.sqrt(2 * np.pi) * sigma * 0.5)
    assert rows()[1, PEAK] == pytest.approx(lengths)
    # one angle in all: as dense as a billionth of a radian is narrow
    assert rows()[0, PEAK] == pytest.approx(lengths / (np.sqrt(2 * np.pi) * ANGLE_STD * 1e9))


def test_what_is_not_measured_weighs_nothing():
    found = rows()
    assert (found[:, [VALUES + 1, SURE + 1]] == 0).all()
    assert found[1, [VALUES + 2, SURE + 2]].tolist() == [0.0, 0.0]
    assert found[0, [VALUES + 2, SURE + 2]] == pytest.approx([3.0, 1 / ANGLE_STD])


@pytest.mark.slow
def test_order_of_rows_within_a_step_does_not_matter():
    scene = gs.Scene.load("hall")
    heard = gs.simulate(scene, "agent1", seed=2)
    columns = {name: np.array(getattr(heard, name)) for name in NAMES}
    order = np.lexsort((np.random.default_rng(3).random(len(heard.step)), heard.step))
    mixed = {name: values[order] for name, values in columns.items()}
    one, other = explain(columns, scene, "agent1"), explain(mixed, scene, "agent1")
    assert other.evidence == pytest.approx(one.evidence)
    heard = one.probability > 0  # all rows of an anchor out of sight are equally unlikely
    assert heard.sum() > 100
    assert (order[other.row] == one.row)[heard].all()
