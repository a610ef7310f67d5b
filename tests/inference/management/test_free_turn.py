"""The turn about an only anchor that tells no departures: held out of the belief, put back, never learned."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import gridslam as gs
from gridslam.inference.beliefs.belief import Belief
from gridslam.inference.management.free_turn import (
    LEFT,
    curvature,
    direction,
    held_at_least,
    off_ring,
    position_spread,
    put_back,
    shortened,
    turn_followed,
    turn_of_all,
    with_turn,
    without_turn,
)
from gridslam.inference.management.hypotheses import advance_population
from gridslam.inference.management.poses.pose_recovery import is_vague
from gridslam.inference.state.network.belief import NetworkBelief
from gridslam.inference.state.population import Population
from gridslam.inference.state.state import State
from gridslam.systems.grid import start
from gridslam.world.geometry import mirror, unit, wrap
from gridslam.world.network_scan import NetworkScan
from gridslam.world.start import assumed_start


def alone(steps=60):
    """The room with its first anchor alone, and an agent that starts as a user would say."""
    data = gs.Scene.load("room").model_dump(exclude_none=True)
    data["anchors"], data["filter"]["particles"] = data["anchors"][:1], 512
    data["agents"] = [{**data["agents"][0], "steps": steps}]
    return gs.Scene.checked(data, "room")


@pytest.fixture(scope="module")
def lone_anchor():
    return alone()


@pytest.fixture(scope="module")
def model(lone_anchor):
    return lone_anchor.filter_model("agent1")


def heard(scene, seed):
    """What its agent measures, without departures."""
    table = gs.simulate(scene, "agent1", seed)
    return replace(table, aod_rad=np.full_like(table.aod_rad, np.nan))


def drawn_state(model, seed):
    """A state that believes in two walls, correlated with the agent."""
    draw = np.random.default_rng(seed)
    root = draw.normal(size=(9, 9))
    mean = np.array([*draw.uniform(-3, 3, 2), *draw.normal(size=2), *draw.uniform(-3, 3, 5)])
    return replace(State.start(model), belief=Belief(mean, 0.01 * root @ root.T + 1e-3 * np.eye(9)))


def turned(mean, place, angle):
    """Agent and lines turned about a place."""
    c, s = np.cos(angle), np.sin(angle)
    turn, after = np.array([[c, -s], [s, c]]), mean.copy()
    after[:2], after[2:4] = place + turn @ (mean[:2] - place), turn @ mean[2:4]
    after[4] += angle
    foot = [unit(a) * b for a, b in mean[5:].reshape(-1, 2)]
    moved = [place + turn @ (f - place) for f in foot]
    angles = mean[5::2] + angle
    after[5::2] = angles
    after[6::2] = [unit(a) @ m for a, m in zip(angles, moved, strict=True)]
    return after


@given(st.integers(0, 10_000), st.tuples(st.floats(-5, 5), st.floats(-5, 5)))
def test_direction_is_that_of_a_small_turn_of_everything(seed, place):
    draw, place = np.random.default_rng(seed), np.array(place)
    mean, small = draw.normal(size=9), 1e-6
    change = (turned(mean, place, small) - turned(mean, place, -small)) / (2 * small)
    np.testing.assert_allclose(direction(Belief(mean, np.eye(9)), place), change, atol=1e-7)


@given(st.integers(0, 10_000), st.tuples(st.floats(-5, 5), st.floats(-5, 5)))
def test_curvature_is_how_that_direction_turns_itself(seed, place):
    draw, place = np.random.default_rng(seed), np.array(place)
    mean, small = draw.normal(size=9), 1e-3
    change = (turned(mean, place, small) - 2 * mean + turned(mean, place, -small)) / small**2
    np.testing.assert_allclose(curvature(Belief(mean, np.eye(9)), place), change, atol=1e-5)


@pytest.mark.parametrize(
    ("turn_rad", "inwards"), [(0.01, 0.866e-4), (0.1, 8.63e-3), (0.3, 0.0751), (np.pi / np.sqrt(3), 1.056)]
)
def test_a_turn_leads_inwards_by_as_much_as_normal_draws_of_it_do(turn_rad, inwards):
    """Root mean squares of 1 - cos; for small turns the root of 3 / 4 of their variance."""
    drawn = 1 - np.cos(turn_rad * np.random.default_rng(1).standard_normal(400_000))
    assert np.sqrt(shortened(turn_rad**2)) == pytest.approx(np.sqrt((drawn**2).mean()), rel=0.01)
    assert np.sqrt(shortened(turn_rad**2)) == pytest.approx(inwards, rel=2e-3)


def test_who_may_be_anywhere_on_a_ring_claims_what_the_ring_is_deep(model):
    """10 degrees about an anchor 4 m away: 0.7 m to either side, 11 cm inwards."""
    mean = np.zeros(5)
    mean[:2] = model.places[0, :2] + np.array([4.0, 0.0])
    state = replace(State.start(model), belief=Belief(mean, 1e-4 * np.eye(5)))
    state = with_turn(replace(state, turn_variance=np.radians(10.0) ** 2, turn_anchor=0), model)
    inwards, aside = np.sqrt(np.diag(state.belief.covariance)[:2])
    assert aside == pytest.approx(4 * np.radians(10.0), rel=1e-3)
    assert inwards == pytest.approx(np.hypot(0.01, 4 * np.sqrt(0.75) * np.radians(10.0) ** 2), rel=0.02)


def test_an_agent_that_may_have_gone_round_its_only_anchor_is_vague_on_a_ring_alone(model):
    """0.5 rad round the anchor, 4 m away, are 2 m aside; 5 cm outwards stay, and so does what isn't held."""
    mean, place = np.zeros(5), model.places[0, :2]
    mean[:2] = place + np.array([4.0, 0.0])
    way = np.array([0.0, 4.0, 0.0, 0.0, 1.0])
    wide = np.diag([0.05**2, 1e-4, 0.01, 0.01, 1e-4]) + 0.5**2 * np.outer(way, way)
    state = replace(State.start(model), belief=Belief(mean, wide))
    assert off_ring(state, model) is state.belief
    assert is_vague(state.belief, arrives=True)
    rest = off_ring(replace(state, turn_variance=0.01, turn_anchor=0), model)
    assert not is_vague(rest, arrives=True)
    assert np.sqrt(rest.covariance[0, 0]) == pytest.approx(0.05, rel=1e-6)
    assert np.sqrt(rest.covariance[1, 1]) < 0.05
    assert np.linalg.eigvalsh(rest.covariance).min() > 0
    lost = replace(state, belief=Belief(mean, wide + np.diag([4.0, 0, 0, 0, 0])), turn_variance=0.01)
    assert is_vague(off_ring(replace(lost, turn_anchor=0), model), arrives=True), (
        "the anchor would tell how far it is"
    )


@given(st.integers(0, 10_000), st.tuples(st.floats(-5, 5), st.floats(-5, 5)))
def test_several_agents_turn_together_and_their_clocks_stay(seed, place):
    draw, place = np.random.default_rng(seed), np.array(place)
    mean = draw.normal(size=2 * 6 + 1 + 4)  # two agents with clocks, an anchor's clock, two lines
    way = direction(NetworkBelief(mean, np.eye(len(mean)), clocks=1, agents=2), place)
    lines = mean[13:]
    for agent in range(2):
        own = slice(6 * agent, 6 * agent + 5)
        alone = direction(Belief(np.concatenate([mean[own], lines]), np.eye(9)), place)
        np.testing.assert_array_equal(way[own], alone[:5])
        np.testing.assert_array_equal(way[13:], alone[5:])
    assert not way[[5, 11, 12]].any()


@given(st.integers(0, 10_000), st.floats(-3, 3))
def test_distances_and_arrivals_stay_as_they_are_when_all_turns(seed, angle):
    draw = np.random.default_rng(seed)
    place, mean = draw.normal(size=2), draw.normal(size=9)

    def paths(at):
        images = [place, *mirror(at[5:].reshape(-1, 2), place)]
        gaps = np.array(images) - at[:2]
        return np.hypot(*gaps.T), np.arctan2(gaps[:, 1], gaps[:, 0]) - at[4]

    (distance, arrival), (distance_after, arrival_after) = paths(mean), paths(turned(mean, place, angle))
    np.testing.assert_allclose(distance_after, distance, atol=1e-9)
    np.testing.assert_allclose(wrap(arrival_after - arrival), 0, atol=1e-6)


@given(st.integers(0, 10_000))
def test_what_is_held_out_is_all_that_is_believed_about_the_turn(model, seed):
    state = drawn_state(model, seed)
    way = direction(state.belief, model.places[0, :2])
    told = way @ np.linalg.solve(state.belief.covariance, way)
    held = without_turn(state, model)
    assert held.turn_variance == pytest.approx(max(1 / told - LEFT, 0))
    left = way @ np.linalg.solve(held.belief.covariance, way)
    assert left == pytest.approx(max(told, 1 / LEFT), rel=1e-3)
    assert np.linalg.eigvalsh(held.belief.covariance).min() > 0
    np.testing.assert_array_equal(held.belief.mean, state.belief.mean)
    inwards = curvature(state.belief, model.places[0, :2])
    ring = shortened(held.turn_variance) * np.outer(inwards, inwards)
    back = put_back(held, model).belief.covariance
    np.testing.assert_allclose(back, state.belief.covariance, atol=1e-9)
    whole = with_turn(held, model).belief.covariance
    np.testing.assert_allclose(whole, back + ring, atol=1e-12)
    assert position_spread(held, model) == np.sqrt(whole[0, 0] + whole[1, 1])


def test_an_agent_that_goes_on_before_anything_is_mapped_turns_all_there_is(model):
    """What it may have gone round its anchor since is the turn's, too, until it has walls."""
    mean, place = np.zeros(5), model.places[0, :2]
    mean[:2] = place + np.array([4.0, 0.0])
    state = replace(State.start(model), belief=Belief(mean, np.diag([0.05**2, 1e-3, 1e-4, 1e-4, 0.01])))
    held = without_turn(state, model)
    way = direction(held.belief, place)
    gone = replace(held.belief, covariance=held.belief.covariance + 0.04 * np.outer(way, way))
    later = without_turn(held.believing(gone), model)
    assert later.turn_variance == pytest.approx(held.turn_variance + 0.04, rel=1e-6)
    np.testing.assert_allclose(later.belief.covariance, held.belief.covariance, atol=1e-9)
    np.testing.assert_allclose(
        put_back(later, model).belief.covariance, put_back(held.believing(gone), model).belief.covariance,
        atol=1e-9,
    )  # fmt: skip
    walled = without_turn(drawn_state(model, 4), model)
    assert without_turn(walled, model) is walled


@given(st.integers(0, 10_000), st.floats(1e-4, 0.1))
def test_departures_tell_no_more_of_the_turn_than_the_only_anchors_mounting(model, seed, variance):
    """All that is believed of it is held out once, or as much as the mounting leaves open if that is more."""
    state = drawn_state(model, seed)
    held = held_at_least(Population.of(state), variance, model).best
    before = without_turn(state, model)
    np.testing.assert_array_equal(held.belief.covariance, before.belief.covariance)
    assert held.turn_variance == max(variance, before.turn_variance)
    again = held_at_least(Population.of(held), 4 * variance, model).best
    assert again.belief is held.belief
    assert again.turn_variance == max(4 * variance, held.turn_variance)
    way = direction(state.belief, model.places[0, :2])
    back = put_back(again, model).belief.covariance - held.belief.covariance
    np.testing.assert_allclose(back, again.turn_variance * np.outer(way, way), atol=1e-9)


def test_what_is_known_exactly_breaks_nothing(model):
    """A wall without any doubt, as a map may hand it down: the covariance has no inverse, all stays."""
    state = drawn_state(model, 2)
    exact = state.belief.covariance.copy()
    exact[5:7], exact[:, 5:7] = 0.0, 0.0
    held = without_turn(replace(state, belief=replace(state.belief, covariance=exact)), model)
    assert held.turn_variance == 0
    np.testing.assert_array_equal(held.belief.covariance, exact)


def test_departures_put_it_back(model):
    state = drawn_state(model, 1)
    before = Population.of(state)
    held = turn_followed(before, False, model)
    assert held.best.turn_variance > 0
    assert turn_followed(held, False, model).best is held.best
    back = turn_followed(held, True, model).best
    assert back.turn_variance is None
    np.testing.assert_allclose(back.belief.covariance, state.belief.covariance, atol=1e-9)
    assert turn_followed(before, True, model) is before
    assert turn_followed(replace(before, searching=True), False, model).best is state


@pytest.mark.slow
@pytest.mark.parametrize(
    "system", [gs.GridSlam, gs.AdaptiveSlam, gs.VirtualAnchorSlam, gs.NetworkSlam, gs.NetworkGridSlam]
)
def test_nothing_heard_makes_the_turn_surer_than_the_start_does(lone_anchor, model, system):
    table, slam, told = heard(lone_anchor, 1), system(lone_anchor, seed=1), []
    place = model.places[0, :2]
    for step in range(30):
        slam.step(table.scan(step))
        belief = with_turn(slam.state, getattr(slam.model, "agents", [slam.model])[0]).belief
        way = direction(belief, place)
        told.append(way @ np.linalg.solve(belief.covariance, way))
    assert len(slam.state.surfaces) > 2
    assert max(told) < 1.2 * told[0]


def two_agents(scene):
    """The scene with clocks that nobody knows, and a second agent on the first one's way, backwards."""
    data = scene.model_dump(exclude_none=True)
    first = data["agents"][0]
    way = [first["start_m"], *first["waypoints_m"]][::-1]
    second = {**first, "name": "agent2", "start_m": way[0], "waypoints_m": way[1:]}
    second["start_heading_deg"] = float(np.degrees(np.arctan2(*np.subtract(way[1], way[0])[::-1])))
    data["agents"], data["clocks"] = [first, second], {"anchor_prior_ns": 10.0, "agent_prior_ns": 1.0}
    return gs.Scene.checked(data, "room")


@pytest.mark.slow
def test_two_agents_and_their_clocks_about_one_anchor_claim_no_more_than_they_know():
    """Squared errors over variances, 2 if all is right; 35 where the turn is believed to be told."""
    scene, nees = two_agents(alone(40)), []
    for seed in (1, 3):
        table = gs.simulate(scene, ["agent1", "agent2"], seed)
        table = replace(table, table=replace(table.table, aod_rad=np.full_like(table.table.aod_rad, np.nan)))
        done = gs.map_network(scene, table, seed=seed)
        for name, run in done.runs.items():
            off = run.trajectory.position_m[:, :2] - scene.track(name).position_m[:, :2]
            nees.append(np.einsum("ni,nij,nj->n", off, np.linalg.inv(run.covariance[:, :2, :2]), off).mean())
    assert np.mean(nees) < 6


@pytest.mark.slow
def test_errors_are_as_large_as_claimed_about_one_anchor_without_departures(lone_anchor):
    """Of starts that are drawn: squared errors over variances, 2 if all is right, by eight runs."""
    nees, silent = [], 0
    for seed in range(8):
        table, slam = heard(lone_anchor, seed), gs.GridSlam(lone_anchor, seed=seed)
        start = assumed_start(lone_anchor, "agent1", seed)
        slam.start_at(start.position_m, start.heading_rad)
        for step in range(table.steps):
            estimate = slam.step(table.scan(step))
            off = estimate.position_m - table.truth.position_m[step]
            square = off @ np.linalg.solve(estimate.covariance[:2, :2], off)
            nees.append(square)
            silent += square > 20 and estimate.health.ok
    assert 1.2 < np.mean(nees) < 3.2
    assert silent < 0.01 * len(nees)


@pytest.mark.parametrize("system", [gs.GridSlam, gs.NetworkSlam])
def test_it_goes_on_from_a_checkpoint_bit_for_bit(lone_anchor, system, tmp_path):
    table, slam = heard(lone_anchor, 2), system(lone_anchor, seed=2)
    for step in range(4):
        slam.step(table.scan(step))
    assert slam.state.turn_variance > 0
    slam.save(tmp_path / "slam.h5")
    again = system.resume(tmp_path / "slam.h5")
    for step in range(4, 8):
        here, there = slam.step(table.scan(step)), again.step(table.scan(step))
        np.testing.assert_array_equal(here.position_m, there.position_m)
        np.testing.assert_array_equal(here.covariance, there.covariance)


@pytest.mark.parametrize("system", [gs.GridSlam, gs.NetworkSlam])
def test_a_map_says_how_sure_walls_are_with_the_turn(lone_anchor, system):
    table, slam = heard(lone_anchor, 3), system(lone_anchor, seed=3)
    for step in range(25):
        slam.step(table.scan(step))
    own, state = slam.map(), slam.state
    assert len(own.surfaces)
    angles = np.sqrt(own.surface_covariance.diagonal()[::2])
    assert (angles > 0.95 * np.sqrt(state.turn_variance)).all()


def test_who_was_not_there_yet_is_not_turned(lone_anchor):
    scene = two_agents(lone_anchor)
    slam = gs.NetworkSlam(scene, agents=["agent1", "agent2"], seed=1)
    before, none = slam.now.believed, np.zeros(0)
    own = gs.Scan(0, 0.0, np.zeros(0, np.int64), none, none, none, none)
    alone = turn_of_all(before, NetworkScan(0, 0.0, (own, None)), slam.model)
    pose = before.best.belief.layout.pose(1)
    changed = alone.best.belief.covariance - before.best.belief.covariance
    assert alone.best.turn_variance > 0
    assert not changed[pose].any()
    shown, gone_on = (
        one(alone.best, slam.model.agents[0]).belief.covariance for one in (with_turn, put_back)
    )
    assert not (shown - gone_on)[pose].any()
    assert (shown - gone_on)[before.best.belief.layout.pose(0)].any()
    assert changed[before.best.belief.layout.pose(0)].any()
    assert turn_of_all(alone, NetworkScan(1, 1.0, (own, None)), slam.model).best is alone.best
    both = turn_of_all(alone, NetworkScan(1, 1.0, (own, own)), slam.model).best
    at_once = turn_of_all(before, NetworkScan(0, 0.0, (own, own)), slam.model).best
    assert both.turn_variance == pytest.approx(at_once.turn_variance)
    np.testing.assert_allclose(both.belief.covariance, at_once.belief.covariance, atol=1e-9)
    assert both.turning.all()


@pytest.mark.parametrize("wide", ["round the anchor", "anywhere", "turned by a map"])
def test_places_on_one_ring_are_neither_listed_nor_split(lone_anchor, wide):
    slam, table = gs.GridSlam(lone_anchor, seed=1), list(heard(lone_anchor, 3))
    for scan in table[:8]:
        slam.step(scan)
    belief = slam.state.belief
    x, y = belief.mean[:2] - slam.model.places[0, :2]
    way, more = np.zeros(len(belief.mean)), np.zeros_like(belief.covariance)
    way[[0, 1, 4]] = -y, x, 1.0
    more[:2, :2] = 0.25 * np.eye(2)
    about = (0.7 / np.hypot(x, y)) ** 2 * np.outer(way, way)
    wider = belief.covariance + (more if wide == "anywhere" else about)
    state = slam.state.believing(replace(belief, covariance=wider))
    if wide == "turned by a map":
        state = replace(state, turn_variance=0.0)
    after, _ = advance_population(Population.of(state), table[8], slam.model, slam.work, start, slam.advance)
    assert (len(after) > 1) is (wide != "round the anchor")


def test_a_map_is_handed_on_without_the_depth_of_the_ring(lone_anchor):
    """Its walls lie on the ring together: as a doubt of each alone it would keep them from telling places."""
    slam = gs.AdaptiveSlam(lone_anchor, seed=1)
    for scan in list(heard(lone_anchor, 4))[:20]:
        slam.step(scan)
    lines = np.concatenate([slam.state.belief.layout.line(k) for k in range(len(slam.state.surfaces))])
    known, shown = (
        one(slam.state, slam.model).belief.covariance[np.ix_(lines, lines)] for one in (put_back, with_turn)
    )
    handed = slam.map().surface_covariance
    assert len(handed) == len(known)
    np.testing.assert_allclose(handed, known, atol=1e-12)
    assert np.abs(shown - known).max() > 1e-9
