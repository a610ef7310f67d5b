"""OSPA and GOSPA against Stone Soup, where it is installed."""

import datetime

import numpy as np
import pytest

from gridslam.evaluation.metrics import gospa, ospa

SETS = ((0, 3), (3, 0), (1, 1), (2, 5), (4, 4), (6, 3))


def sets(seed):
    draw = np.random.default_rng(seed)
    for count, other in SETS:
        yield draw.uniform(-4, 4, (count, 2)), draw.uniform(-4, 4, (other, 2))


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(("cutoff", "order"), [(5.0, 1), (2.0, 1), (1.0, 2)])
def test_ospa_and_gospa_agree_with_stone_soup(cutoff, order):
    metric = pytest.importorskip("stonesoup.metricgenerator.ospametric", exc_type=ImportError)
    state = pytest.importorskip("stonesoup.types.state", exc_type=ImportError)
    now = datetime.datetime(2026, 1, 1)
    theirs_ospa, theirs_gospa = metric.OSPAMetric(p=order, c=cutoff), metric.GOSPAMetric(p=order, c=cutoff)
    for a, b in sets(order):
        rows = [[state.State(point[:, None], timestamp=now) for point in points] for points in (a, b)]
        expected = theirs_ospa.compute_OSPA_distance(*rows).value
        assert ospa(a, b, cutoff, order) == pytest.approx(expected, rel=1e-9)
        expected = theirs_gospa.compute_gospa_metric(*rows)[0].value["distance"]
        assert gospa(a, b, cutoff, order) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("order", [1.0, 2.0])
def test_gospa_adds_up_from_matched_missed_and_false_points(order):
    truth = np.array([[0.0, 0.0], [10.0, 0.0], [20.0, 0.0]])
    found = np.array(
        [[0.3, 0.4], [10.0, 1.9], [40.0, 0.0]]
    )  # near, near enough, false (and the third missed)
    expected = (0.5**order + 1.9**order + 2 * 0.5 * 2.0**order) ** (1 / order)
    assert gospa(found, truth, 2.0, order) == pytest.approx(expected)
