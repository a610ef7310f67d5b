"""What `check` weighs rows by, against numbers worked out by hand; and rows in any order within a step."""

import numpy as np
import pytest

import gridslam as gs
from gridslam.checks.line_of_sight_filter import explain
from gridslam.checks.sight_likelihood import ANGLE_STD, SightLikelihood

SCENE = gs.Scene.load("room")
NAMES = ("step", "anchor", "distance_m", "aod_rad", "aoa_rad")


def likelihood():
    """Two rows: distances of 4 and 6 m, so evenly 0.5 per metre; no angle in the second."""
    columns = {"step": [0, 0], "anchor": [0, 0], "distance_m": [4.0, 6.0], "aoa_rad": [3.0, np.nan]}
    return SightLikelihood.of({name: np.array(values) for name, values in columns.items()}, SCENE)


def test_ratio_is_that_of_normal_densities_over_how_dense_the_column_lies():
    made = likelihood()
    sigma = 1 / made.quantities["distance_m"].precision[0]
    there = np.array([[4.0, 4.0 + sigma, 6.0]])
    found = made.ratio(np.array([1]), np.array([0]), {"distance_m": there, "aoa_rad": np.zeros((1, 3))})
    best = 1 / (np.sqrt(2 * np.pi) * sigma * 0.5)
    assert found[0, 2] == pytest.approx(best)
    assert found[0, 0] == pytest.approx(best * np.exp(-0.5 * (2 / sigma) ** 2))


def test_angles_are_compared_by_the_shorter_way_round():
    made = likelihood()
    turned = 3.0 + ANGLE_STD - 2 * np.pi
    expected = {"distance_m": np.full((1, 2), 4.0), "aoa_rad": np.array([[3.0, turned]])}
    same, aside = made.ratio(np.array([0]), np.array([0]), expected)[0]
    assert aside / same == pytest.approx(np.exp(-0.5))


def test_rows_are_weighed_by_the_scan_that_they_are_of():
    expected = {"distance_m": np.array([[4.0], [6.0]]), "aoa_rad": np.array([[3.0], [0.0]])}
    right = likelihood().ratio(np.array([0, 1]), np.array([0, 1]), expected)
    crossed = likelihood().ratio(np.array([0, 1]), np.array([1, 0]), expected)
    assert (right > 1e3 * crossed).all()


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
