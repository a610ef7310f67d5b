"""Lines of sight alone tell where agents of a network are, whatever map and clocks they agree upon."""

from dataclasses import replace

import numpy as np
import pytest
from scene_samples import short

import gridslam as gs
from gridslam.inference.health.fresh_look import AGREED, TOGETHER_M, FreshLook
from gridslam.inference.management.network.fresh_look import EVERY, look_afresh
from gridslam.inference.state.network.clock_search import ClockSearch
from gridslam.systems.network import NetworkSlam
from gridslam.systems.network_grid import NetworkGridSlam
from gridslam.world.clocks import ClockModel
from gridslam.world.geometry import wrap

AGENTS = ["agent1", "agent2"]
OFF_M = np.array([2.0, 5.0])


@pytest.fixture(scope="module", params=[NetworkSlam, NetworkGridSlam])
def hall(request):
    """A network of two agents after some steps of `exchange`, without labels, and the next scan."""
    scene = short("exchange", 7, particles=500)
    radio = scene.radio.model_copy(update={"measures": ("distance", "aod", "aoa", "amplitude")})
    scene = scene.model_copy(update={"radio": radio})
    slam = request.param(scene, agents=AGENTS, seed=1)
    data = gs.simulate(scene, AGENTS, 1, unlabelled=True)
    for step in range(6):
        slam.step(data.scan(step))
    return slam, data.scan(6), [scene.track(name).position_m[6, :2] for name in AGENTS]


def carried(state, agents):
    """The state with some agents believed in at another place, as surely as before."""
    mean = state.belief.mean.copy()
    for agent in agents:
        mean[state.belief.layout.pose(agent).start + np.arange(2)] += OFF_M
    return replace(state, belief=replace(state.belief, mean=mean), step=EVERY)


def test_where_agents_clocks_are_wide_health_alone_tells(hall):
    """With no clock to go by, what seems a line of sight is often a reflection's."""
    slam, scan, _ = hall
    lost = carried(slam.state, range(2))
    lost = replace(lost, clocks=ClockSearch.start(ClockModel(4, 2, np.full(6, 15.0))))
    after = looked(slam, lost, scan)
    assert after.belief is lost.belief
    assert all(record.monitor.look.reasons() for record in after.records)


def looked(slam, state, scan, times=AGREED):
    for number in range(times):
        state = look_afresh(replace(state, step=EVERY + number), scan.scans, slam.model, slam.work)
    return state


def test_what_lines_of_sight_bear_out_stays_as_it_is(hall):
    slam, scan, _ = hall
    state = replace(slam.state, step=EVERY)
    after = look_afresh(state, scan.scans, slam.model, slam.work)
    assert after.belief is state.belief
    assert not any(record.monitor.look.reasons() for record in after.records)


def test_agents_that_are_all_elsewhere_begin_anew_where_lines_of_sight_put_them(hall):
    slam, scan, true = hall
    lost = carried(slam.state, range(2))
    called = looked(slam, lost, scan, AGREED - 1)
    assert [record.monitor.look.agreed for record in called.records] == [AGREED - 1] * 2
    assert called.belief is lost.belief
    after = looked(slam, lost, scan)
    assert len(after.surfaces) == 0
    assert after.clocks.unset.all()
    assert (after.grid is None) == (slam.state.grid is None)
    if after.grid is not None:
        assert not after.grid.observed.any()
    for agent, place in enumerate(true):
        rows = after.belief.layout.pose(agent).start + np.arange(2)
        assert np.linalg.norm(after.belief.mean[rows] - place) < 0.3
        assert after.records[agent].monitor.since == 0


def test_an_agent_that_is_elsewhere_alone_is_called_and_keeps_the_map(hall):
    slam, scan, _ = hall
    lost = carried(slam.state, [1])
    after = looked(slam, lost, scan)
    assert after.belief is lost.belief
    well, wrong = (record.monitor.look for record in after.records)
    assert not well.reasons()
    assert "another place" in wrong.reasons()[0]


def test_looks_call_once_they_agree_in_a_row():
    look = FreshLook()
    for number in range(AGREED):
        assert not look.called
        look = look.elsewhere(60.0, 0.1 * number, 2.0)
    assert look.called
    assert not look.elsewhere(60.0, 0.2 + 1.1 * TOGETHER_M, 2.0).called
    assert not look.here().called


def heard_at(model, anchors, pose):
    """The lines of sight of some anchors at a pose, without noise."""
    toward = model.places[anchors, :2] - pose[:2]
    distance, back = np.hypot(*toward.T), np.arctan2(*toward.T[::-1])
    return gs.Scan(
        EVERY, float(EVERY), anchors, distance, wrap(back + np.pi - model.places[anchors, 2]),
        wrap(back - pose[2]), np.asarray(model.radio.amplitude(distance, 1.0)),
    )  # fmt: skip


def agreed(slam, pose, scan):
    """Looks that put the first agent elsewhere than it is believed to be, after two scans."""
    mean = slam.state.belief.mean.copy()
    mean[np.array([0, 1, 4])] = pose
    state = replace(slam.state, belief=replace(slam.state.belief, mean=mean))
    for number in range(AGREED - 1):  # one fewer: nothing begins anew
        state = look_afresh(replace(state, step=EVERY + number), [scan, None], slam.model, slam.work)
    return state.records[0].monitor.look.agreed


@pytest.mark.parametrize("place", [(0.0, -6.05), (-1.0, -3.0), (0.5, -5.0)])
def test_an_agent_that_is_elsewhere_is_called_in_the_line_of_its_anchors_too(hall, place):
    slam, _, _ = hall
    scan = heard_at(slam.model.agents[0], np.array([0, 1]), np.array([*place, 0.4]))
    assert agreed(slam, [place[0] + OFF_M[0], place[1] + OFF_M[1], 0.4], scan) == AGREED - 1


@pytest.mark.parametrize("mirrored", [True, False])
def test_what_one_mirror_shows_of_two_anchors_in_line_is_no_other_place(hall, mirrored):
    """What both send over a wall looks like lines of sight from behind it; with another heading it can't."""
    slam, _, _ = hall
    model, anchors = slam.model.agents[0], np.array([2, 3])
    far, near = model.places[2, :2], model.places[3, :2]
    image = near + 3.0 * (near - far) / np.hypot(*(near - far))  # in their line
    believed = np.array([-7.0, image[1] - 2.5, 0.7])
    wall = np.arctan2(*(image - believed[:2])[::-1])
    toward = np.arctan2(*(near - image)[::-1])
    told = 2 * toward + believed[2] - 2 * wall - np.pi
    scan = heard_at(model, anchors, np.array([*image, told + (0.0 if mirrored else 1.5)]))
    assert agreed(slam, believed, scan) == (0 if mirrored else AGREED - 1)
