"""Paths that no anchor can have sent to where an agent of a network is believed to be."""

from dataclasses import replace

import numpy as np
import pytest
from scene_samples import short

from gridslam.estimates import Health
from gridslam.inference.beliefs.layout import AGENT
from gridslam.inference.health import reasons
from gridslam.inference.health.early_watch import EARLY, KEEP, no_anchors
from gridslam.inference.management.network.recovery import recover_agents
from gridslam.inference.management.step_info import StepInfo
from gridslam.inference.scans.anchor_measurements import whole_scan
from gridslam.simulation.network import simulate_network
from gridslam.systems.network import NetworkSlam, take_turns

WELL = Health(True, "", np.inf, 1.0, (0.0, 2.0), 1.0, np.zeros(2), 1.0, np.zeros(2), 0)


@pytest.fixture(scope="module")
def room():
    """A network of one agent that is where it is, clocks right though their priors are wide, and a scan."""
    scene = short("room", 10, particles=50)
    tables = scene.model_dump(exclude_none=True) | {
        "clocks": {"anchor_prior_ns": 60.0, "agent_prior_ns": 1.0}
    }
    tables["radio"] |= {"window_m": [-30.0, 80.0], "max_distance_m": 80.0}
    scene = type(scene).checked(tables, "room")
    slam = NetworkSlam(scene, agents=["agent1"], seed=1)
    state, mean = slam.state, slam.state.belief.mean.copy()
    mean[state.belief.layout.pose(0).start + np.arange(2)] = scene.track("agent1").position_m[9, :2]
    right = replace(state, belief=replace(state.belief, mean=mean))
    slam.now = slam.now._replace(believed=replace(slam.now.believed, states=(right,)))
    return slam, list(simulate_network(scene, ["agent1"], 1)[0])[9]


def moved(belief, by):
    mean = belief.mean.copy()
    mean[:2] += by
    return replace(belief, mean=mean)


def off(slam, scan, labelled, by, **changes):
    """Whether a scan contradicts a place that is off by so much."""
    model, part = slam.model.agents[0], slam.state.part(0)
    heard = whole_scan(scan.scans[0], model)
    heard = heard if labelled else replace(heard, label=np.full(len(heard), -1))
    belief = moved(part.belief, by)
    belief = replace(belief, **{name: change(belief) for name, change in changes.items()})
    return no_anchors(heard, belief, model, model.radio)


def sure(belief):
    """The belief with position and clocks known to a centimetre, each by itself."""
    covariance = belief.covariance.copy()
    rows = [0, 1, *range(AGENT, AGENT + belief.clocks)]
    covariance[rows], covariance[:, rows] = 0.0, 0.0
    covariance[rows, rows] = 1e-4
    return covariance


def unset(belief):
    covariance = sure(belief)
    rows = np.arange(AGENT, AGENT + belief.clocks)
    covariance[rows, rows] = 100.0
    return covariance


@pytest.mark.parametrize("labelled", [True, False])
def test_a_right_place_is_not_contradicted_and_one_that_is_off_is_unless_clocks_are_open(room, labelled):
    slam, scan = room
    middle = slam.model.agents[0].anchor_positions.mean(0)
    away = 3.0 * np.sign(slam.state.part(0).belief.mean[:2] - middle)
    assert not off(slam, scan, labelled, by=0.0, covariance=sure)
    assert off(slam, scan, labelled, by=away, covariance=sure)
    assert not off(slam, scan, labelled, by=away, covariance=unset), "an open clock may send anything"


def test_a_path_that_is_too_loud_for_its_length_is_of_no_anchor(room):
    """Without labels a far anchor's clock would explain any early path, were it not so loud."""
    slam, scan = room
    model, part = slam.model.agents[0], slam.state.part(0)
    heard = whole_scan(scan.scans[0], model)
    loudest = int(np.argmax(heard.amplitude))
    value, nobody = heard.value.copy(), np.full(len(heard), -1)
    value[loudest, 0] += 40.0  # as of an anchor with a clock so far ahead
    far, late = replace(heard, value=value, label=nobody), replace(part.belief, covariance=sure(part.belief))
    assert no_anchors(far, late, model, model.radio)
    faint = heard.amplitude.copy()
    faint[loudest] = model.radio.amplitude(40.0)
    assert not no_anchors(replace(far, amplitude=faint), late, model, model.radio)


def test_health_says_so_and_who_is_contradicted_for_long_is_lost(room):
    slam, scan = room
    state = slam.state
    monitor = replace(state.records[0].monitor, early=0.5)
    believed = state.recorded(0, monitor)
    info = StepInfo((), WELL, {}, False, np.zeros(2), 1.0)
    after, infos = take_turns(believed, scan, None, slam.model, slam.work, lambda part, *_: (part, info))
    assert infos[0].health.why == reasons.early(0.5 * KEEP)
    assert after.records[0].monitor.early == 0.5 * KEEP
    wrong = replace(believed, labelled=False)
    found = recover_agents(wrong, scan.scans, None, slam.model, slam.work)
    assert found.records[0].monitor.astray
    well = replace(monitor, early=EARLY)
    kept = recover_agents(wrong.recorded(0, well), scan.scans, None, slam.model, slam.work)
    assert not kept.records[0].monitor.astray
