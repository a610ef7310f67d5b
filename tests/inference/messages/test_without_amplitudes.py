"""Measurements without amplitudes: how exact they are, and how much clutter they tell of."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from filter_states import model_of, state_of

import gridslam as gs
from gridslam.inference.beliefs.belief import Belief
from gridslam.inference.messages.clutter import learn_clutter
from gridslam.inference.messages.likelihood_ratios import evaluate
from gridslam.inference.messages.path_prediction import predict_paths
from gridslam.inference.scans.anchor_measurements import split_by_anchor
from gridslam.inference.workspace.workspace import Workspace
from gridslam.kernels.primitives.tables import DISTANCE, VARIANCE

ANGLES = ["distance", "aod", "aoa"]


@dataclass(frozen=True)
class LoudOrFaint:
    """An amplitude of 20 or of 5, either as likely."""

    probability: np.ndarray
    nodes: np.ndarray
    spreading: bool = False


def ratios_of(amplitude):
    """Ratios of a scan of one line of sight, 5 m long, by a radio of 1 GHz; and all that they are of."""
    radio = replace(model_of().radio, bandwidth_hz=1e9, threshold=2.0)
    model = model_of(anchors=[[0.0, 0.0, 0.0]], radio=radio)
    mean = np.array([5.0, 0, 0, 0, 0])
    state, work = state_of(Belief(mean, 1e-8 * np.eye(5))), Workspace(model, seed=1)
    scan = gs.Scan(
        step=0,
        time_s=0.0,
        anchor=[0],
        distance_m=np.array([5.0]),
        aod_rad=np.array([0.0]),
        aoa_rad=np.array([np.pi]),
        amplitude=np.array([amplitude]),
    )
    work.begin()
    scan = split_by_anchor(scan, model)[0]
    paths = predict_paths(state, 0, model, work=work)
    strength = LoudOrFaint(np.full((len(paths), 2), 0.5), np.array([20.0, 5.0]))
    _, ratios = evaluate(scan, paths, np.ones(len(paths)), strength, radio, model, work=work)
    return state, scan, ratios, radio, model


def test_what_has_no_amplitude_is_as_exact_as_it_is_in_the_mean():
    """By hand: 1 GHz gives 5.85 mm at an amplitude of 20, 23.4 mm at 5, and both are detected for sure."""
    pair = ratios_of(np.nan)[2].pairs.pair[0]
    assert np.sqrt(pair[VARIANCE + DISTANCE]) == pytest.approx(
        np.hypot(5.85e-3, 23.4e-3) / np.sqrt(2), rel=2e-3
    )


@pytest.mark.parametrize(("amplitude", "std_m"), [(20.0, 5.85e-3), (5.0, 23.4e-3)])
def test_what_has_one_is_as_exact_as_that_says(amplitude, std_m):
    pair = ratios_of(amplitude)[2].pairs.pair[0]
    assert np.sqrt(pair[VARIANCE + DISTANCE]) == pytest.approx(std_m, rel=2e-3)


@pytest.mark.parametrize(
    ("amplitude", "steps"),
    [([np.nan] * 4, 0.1), ([3.0, np.nan, np.nan, 3.0], 0.5), ([3.0] * 4, 1.0), ([], 1.0)],
)
def test_a_scan_tells_of_clutter_as_far_as_it_has_amplitudes(amplitude, steps):
    state, _, ratios, radio, model = ratios_of(np.nan)
    none = np.full(len(amplitude), 1.0)
    scan = gs.Scan(
        step=0, time_s=0.0, anchor=[0] * len(none), distance_m=9 * none, aod_rad=none, aoa_rad=none,
        amplitude=np.array(amplitude, float),
    )  # fmt: skip
    (scan,) = split_by_anchor(scan, model)
    learned, _, _ = learn_clutter(state, scan, ratios, radio, model)
    assert learned.calibration.listened[0] == pytest.approx(steps)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["room", "hall"])
def test_walls_that_are_still_to_be_born_are_no_clutter_and_nobody_is_called_lost(name):
    """As many paths as there are walls, of which nothing but their coming again tells that they are none."""
    whole = gs.Scene.load(name).model_dump(exclude_none=True)
    whole["radio"] |= {"measures": ANGLES, "false_alarms": 0.2}
    whole["agents"][0]["steps"], whole["filter"]["particles"] = 25, 200
    scene = gs.Scene.checked(whole, "test")
    run = gs.map_scene(scene, gs.simulate(scene, "agent1", 70), seed=70, start="exact")
    assert all(estimate.health.ok for estimate in run.estimates), [e.health.why for e in run.estimates]
    assert len(run.estimates[2].surfaces) >= 4
