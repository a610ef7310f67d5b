"""Surfaces out of sight: parked beside the joint belief, following it, and brought back."""

from dataclasses import replace

import h5py
import numpy as np
import pytest
from filter_states import model_of, state_of
from scene_samples import shortened
from scipy.optimize import linear_sum_assignment

import gridslam as gs
from gridslam.errors import InputError
from gridslam.evaluation.surface_truth import AudibleSurfaces
from gridslam.inference.beliefs.belief import Belief, give_birth, update
from gridslam.inference.management.in_sight import occupied_above, shortest_path
from gridslam.inference.management.merging import MOST_SURFACES
from gridslam.inference.management.mixture import moment_matched, same_identities
from gridslam.inference.management.parking import park, recall, same_as_young
from gridslam.inference.messages.motion import predict
from gridslam.inference.state.arrangement import arranged, unparked, without
from gridslam.inference.state.grid import Grid
from gridslam.simulation.image_source import ground_truth


def believed(count, seed=1, size=0.1):
    """A state of an agent and `count` surfaces, all correlated, seen often and surely there."""
    draw = np.random.default_rng(seed)
    entries = 5 + 2 * count
    root = size * draw.normal(size=(entries, entries)) / np.sqrt(entries)
    mean = np.concatenate([[0, 0, 0.1, 0, 0.2], draw.uniform(0.2, 3, 2 * count)])
    state = state_of(Belief(mean, root @ root.T), existence=0.95)
    bank = state.surfaces
    seen = np.full(count, 50)
    bank = replace(
        bank, seen=seen, age=seen + 50, extent=np.tile([-1.0, 1.0], (count, 1)), single=bank.single * 0
    )
    return replace(state, surfaces=replace(bank, double=bank.double * 0), next_identity=count, time_s=0.0)


def same_belief(one, other, **more):
    one, other = unparked(one), unparked(other)
    np.testing.assert_array_equal(one.surfaces.identity, other.surfaces.identity)
    np.testing.assert_allclose(one.belief.mean, other.belief.mean, **more)
    np.testing.assert_allclose(one.belief.covariance, other.belief.covariance, **more)


def some(count, *rows):
    chosen = np.ones(count, bool)
    chosen[list(rows)] = False
    return chosen


def seen(state, seed):
    """After a measurement of the agent and the first two surfaces of the belief."""
    draw, size = np.random.default_rng(seed), len(state.belief.mean)
    jacobian = np.zeros((3, size))
    jacobian[:, :9] = draw.normal(size=(3, 9))
    noise = np.full((1, 3), 1e-4)
    return replace(
        state, belief=update(state.belief, jacobian, draw.normal(size=(1, 3)) * 0.05, noise, np.ones(1))
    )


def test_parking_and_recalling_forgets_nothing_and_keeps_the_order():
    state = believed(5)
    away = arranged(state, some(5, 1, 3))
    assert away.surfaces.identity.tolist() == [0, 2, 4]
    assert away.parked.surfaces.identity.tolist() == [1, 3]
    back = unparked(away)
    assert back.parked is None
    np.testing.assert_array_equal(back.belief.mean, state.belief.mean)
    np.testing.assert_array_equal(back.belief.covariance, state.belief.covariance)
    np.testing.assert_array_equal(away.every_existence[[0, 3, 1, 4, 2]], state.surfaces.existence)
    np.testing.assert_array_equal(away.every_line[[0, 3, 1, 4, 2]], state.belief.lines)


def test_parked_surfaces_follow_exactly_as_if_they_stood_in_the_belief():
    whole, model = believed(6), model_of(anchors=[[5.0, 5.0]])
    parted = arranged(whole, some(6, 3, 4, 5))
    for step in range(3):
        whole, parted = (predict(s, step + 1.0, 3, model) for s in (whole, parted))
        before = parted
        whole, parted = (seen(s, step) for s in (whole, parted))
        parted = park(before, parted, model)
        same_belief(whole, parted, rtol=1e-7, atol=1e-10)
    assert np.linalg.eigvalsh(unparked(parted).belief.covariance).min() > 0


def test_newborn_surfaces_are_correlated_with_parked_ones_and_lost_ones_are_not_needed():
    whole, model = believed(6), model_of(anchors=[[5.0, 5.0]])
    parted = arranged(whole, some(6, 4, 5))
    draw = np.random.default_rng(3)

    def born(state):
        by_state = np.zeros((2, len(state.belief.mean)))
        by_state[:, :5] = draw.normal(size=(2, 5))
        belief = give_birth(state.belief, np.array([1.0, 2.0]), by_state, np.eye(2), np.full(2, 1e-3))
        bank = state.surfaces.add(9, 0.9, np.full(20, 0.05), 0.0, (0, -1, -1))
        return replace(state, belief=belief, surfaces=bank, next_identity=10)

    draw = np.random.default_rng(3)
    plain = born(seen(whole, 1))
    draw = np.random.default_rng(3)
    after = park(parted, born(seen(parted, 1)), model)
    same_belief(plain, after, rtol=1e-7, atol=1e-10)
    # one that is pruned takes what it knew with it
    gone = without(after, np.arange(len(after.surfaces)) == 2)
    left = without(plain, plain.surfaces.identity == 2)
    same_belief(left, gone, rtol=1e-7, atol=1e-10)
    later = park(after, replace(after, belief=gone.belief, surfaces=gone.surfaces), model)
    same_belief(left, later, rtol=1e-6, atol=1e-9)


def test_an_agent_that_is_put_elsewhere_is_independent_of_what_is_parked():
    from gridslam.inference.management.branching import conditioned, placed

    state = arranged(believed(4), some(4, 2, 3))
    moved = placed(state, np.array([1.0, 1, 1]), 0.01 * np.eye(3), 0.1)
    assert not unparked(moved).belief.covariance[:5, 5:].any()
    pose, covariance = state.belief.mean[[0, 1, 4]] + 0.05, 1e-4 * np.eye(3)
    expected = conditioned(state, pose, covariance)
    same_belief(conditioned(unparked(state), pose, covariance), expected, rtol=1e-6, atol=1e-9)


def test_siblings_are_matched_with_what_they_parked():
    one = arranged(believed(4), some(4, 2, 3))
    other = seen(one, 5)
    other = one.believing(other.belief)
    model = model_of(anchors=[[5.0, 5.0]])
    assert same_identities(one, other, model)
    assert not same_identities(one, unparked(other), model)
    both = moment_matched(one, other, 0.0, 0.0)
    whole = moment_matched(unparked(one), unparked(other), 0.0, 0.0)
    same_belief(both, whole, rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(both.surfaces.identity, one.surfaces.identity)


def corridor(count, grid=None):
    """Parallel walls, one metre apart, and an agent far beyond the last; each was hit about x = 0."""
    state = believed(count, size=1e-3)
    lines = np.stack([np.full(count, 0.5 * np.pi), 2.0 + np.arange(count)], -1)
    mean = np.concatenate([[0.0, 0.0, 0, 0, 0], lines.reshape(-1)])
    belief = replace(state.belief, mean=mean)
    return replace(state, belief=belief, grid=grid)


def at(state, x):
    mean = state.belief.mean.copy()
    mean[0] = x
    return replace(state, belief=replace(state.belief, mean=mean))


def test_nothing_is_parked_while_all_fit_in():
    model = model_of(anchors=[[0.0, -1.0]])
    state = at(corridor(MOST_SURFACES), 50.0)
    assert park(state, state, model) is state
    assert recall(state, model) is state


def test_walls_out_of_sight_are_parked_and_come_back_where_they_may_be_seen():
    model = model_of(anchors=[[0.0, -1.0]], radio=replace(model_of().radio, max_distance_m=200.0))
    count = MOST_SURFACES + 3
    far = at(corridor(count), 50.0)
    parted = park(far, far, model)
    assert len(parted.surfaces) == 0
    assert len(parted.parked) == count
    assert parted.monitor.dropped == 0
    assert recall(parted, model).parked is parted.parked
    back = recall(at(parted, 0.5), model)
    assert len(back.surfaces) == MOST_SURFACES
    assert back.surfaces.identity.tolist() == list(range(MOST_SURFACES))  # the nearest
    assert back.monitor.dropped == 3
    np.testing.assert_array_equal(back.surfaces.existence, far.surfaces.existence[:MOST_SURFACES])


def test_an_agent_that_is_elsewhere_all_of_a_sudden_gets_the_walls_there_in_place_of_those_here():
    model = model_of(
        anchors=[[0.0, -1.0], [50.0, -1.0]], radio=replace(model_of().radio, max_distance_m=200.0)
    )
    count = MOST_SURFACES + 6
    state = corridor(count)
    extent = state.surfaces.extent.copy()
    extent[MOST_SURFACES:] -= 50.0  # tangents point towards negative x
    single = np.full_like(state.surfaces.single, 0.9)  # believed in until just now
    bank = replace(state.surfaces, extent=extent, single=np.concatenate([single, single]))
    bank = replace(bank, double=np.concatenate([bank.double, bank.double]))
    state = arranged(replace(state, surfaces=bank), np.arange(count) < MOST_SURFACES)
    there = recall(at(state, 50.0), model)
    assert there.surfaces.identity.tolist() == list(range(MOST_SURFACES, count))
    assert there.monitor.dropped == 0
    assert recall(state, model).parked is state.parked


def test_of_too_many_in_sight_the_least_likely_are_set_aside_and_told_and_tentative_ones_dropped():
    model = model_of(anchors=[[0.0, -1.0]], radio=replace(model_of().radio, max_distance_m=200.0))
    count = MOST_SURFACES + 4
    state = corridor(count)
    existence = np.linspace(0.99, 0.7, count)
    existence[2:4] = 0.4
    state = replace(state, surfaces=replace(state.surfaces, existence=existence))
    after = park(state, state, model)
    assert len(after.surfaces) == MOST_SURFACES
    assert after.parked.surfaces.identity.tolist() == [count - 2, count - 1]
    assert after.monitor.dropped == 2
    assert not {2, 3} & set(after.surfaces.identity.tolist())


def test_a_ray_that_is_believed_in_or_a_doubt_keeps_a_wall_in_the_belief():
    model = model_of(anchors=[[0.0, -1.0]])
    count = MOST_SURFACES + 1
    state = at(corridor(count), 50.0)
    single, often = state.surfaces.single.copy(), state.surfaces.seen.copy()
    single[0, 3], often[4] = 0.8, 3
    state = replace(state, surfaces=replace(state.surfaces, single=single, seen=often))
    assert park(state, state, model).surfaces.identity.tolist() == [3, 4]


def test_occupied_cells_between_hide_a_wall():
    model = model_of("room", anchors=[[0.0, -1.0]])
    grid = Grid.empty(model.grid.shape)
    state = replace(corridor(1), grid=grid)
    lines = state.belief.lines
    assert shortest_path(state, lines, state.surfaces, 1.0, model)[0] == pytest.approx(5.0)
    evidence = grid.evidence.copy()
    row = int((0.5 - model.grid.origin_m[1]) / model.grid.cell_m)
    evidence[row] = occupied_above(model) + 0.1
    hidden = replace(state, grid=replace(grid, evidence=evidence))
    assert np.isinf(shortest_path(hidden, lines, state.surfaces, 1.0, model)[0])
    evidence[row] = occupied_above(model) - 0.1
    open_ = replace(state, grid=replace(grid, evidence=evidence))
    assert np.isfinite(shortest_path(open_, lines, state.surfaces, 1.0, model)[0])


@pytest.mark.parametrize(
    ("x", "anchor", "possible"), [(1.9, 0.0, True), (8.0, 0.0, False), (0.0, 5.0, False)]
)
def test_a_wall_may_be_seen_by_the_stretch_that_was_hit_and_from_one_side(x, anchor, possible):
    model = model_of("room", anchors=[[0.0, anchor]])
    state = at(corridor(1), x)
    assert np.isfinite(shortest_path(state, state.belief.lines, state.surfaces, 1.0, model)[0]) == possible


def test_a_young_surface_that_is_a_parked_wall_brings_it_back():
    model = model_of(anchors=[[0.0, -1.0]])
    state = at(corridor(MOST_SURFACES + 1), 50.0)
    parted = park(state, state, model)
    line = state.belief.lines[4] + [0.004, 0.03]
    flipped = np.array([line[0] + np.pi, -line[1]])
    for given in (line, flipped):
        bank = parted.surfaces.add(90, 0.9, np.full(20, 0.05), 0.0, (0, -1, -1))
        mean = np.concatenate([parted.belief.mean, given])
        joint = np.zeros((7, 7))
        joint[:5, :5], joint[5:, 5:] = parted.belief.covariance, 1e-4 * np.eye(2)
        parked = replace(parted.parked, cross=np.pad(parted.parked.cross, ((0, 0), (0, 2))))
        state = replace(parted, belief=Belief(mean, joint), surfaces=bank, parked=parked)
        assert np.flatnonzero(same_as_young(state, parked)[0]).tolist() == [4]
        assert recall(state, model).surfaces.identity.tolist() == [4, 90]


@pytest.fixture
def crowded(monkeypatch):
    """A filter that takes 3 surfaces into one belief, in a room of 4 walls, after 25 steps."""
    monkeypatch.setattr("gridslam.inference.management.parking.MOST_SURFACES", 3)

    def run(system):
        scene = shortened(gs.Scene.load("room"), 30).with_filter(particles=256)
        scans = list(gs.simulate(scene, "agent1", seed=2))
        slam = system(scene, seed=3)
        for scan in scans[:25]:
            estimate = slam.step(scan)
        return slam, scans[25:], estimate

    return run


@pytest.mark.slow
@pytest.mark.parametrize("system", [gs.GridSlam, gs.AdaptiveSlam])
def test_a_checkpoint_holds_parked_surfaces_and_goes_on_bit_for_bit(system, crowded, tmp_path):
    slam, rest, estimate = crowded(system)
    assert len(slam.state.parked)
    assert "want of room" in estimate.health.why
    assert len(estimate.surfaces) == len(slam.state.surfaces) + len(slam.state.parked)
    grid = slam.map()
    assert len(grid.surfaces) == int(estimate.detected.sum()) >= 4
    assert grid.surface_covariance.shape == (2 * len(grid.surfaces),) * 2
    slam.save(tmp_path / "here.h5")
    again = system.resume(tmp_path / "here.h5")
    for scan in rest:
        one, other = slam.step(scan), again.step(scan)
        np.testing.assert_array_equal(one.covariance, other.covariance)
        np.testing.assert_array_equal(one.surfaces.line_cov, other.surfaces.line_cov)
    np.testing.assert_array_equal(slam.state.parked.cross, again.state.parked.cross)
    with h5py.File(tmp_path / "here.h5", "a") as file:
        file["believed/states/0/parked/cross"][...] *= 1e3
    with pytest.raises(InputError, match="parked"):
        system.resume(tmp_path / "here.h5")


@pytest.mark.slow
def test_once_around_a_building_of_60_walls_the_first_rooms_are_the_same_walls_again():
    scene = gs.Scene.load("building").with_filter(particles=64)
    truth = AudibleSurfaces.of(ground_truth(scene, "agent1"))
    scans = gs.simulate(scene, "agent1", seed=41)
    slam = gs.GridSlam(scene, seed=41)
    errors, active, first, seen = [], [], None, {}
    for scan in scans:
        estimate = slam.step(scan)
        errors.append(estimate.position_m - scans.truth.position_m[scan.step])
        state = slam.state
        active.append(len(state.surfaces))
        if state.parked is not None and first is None:
            first = found(truth, estimate)
            away = state.parked.surfaces
            seen = dict(zip(away.identity.tolist(), away.seen.tolist(), strict=True))
    last = found(truth, estimate)
    assert max(active) <= MOST_SURFACES < len(state.every_existence)
    assert len(last) >= 36  # of 44 that can be heard
    assert int(estimate.detected.sum()) - len(last) <= 2
    both = set(first) & set(last)
    assert sum(first[wall] == last[wall] for wall in both) >= 0.85 * len(both)
    again = dict(zip(state.surfaces.identity.tolist(), state.surfaces.seen.tolist(), strict=True))
    assert sum(again.get(one, 0) > often for one, often in seen.items()) >= 2  # parked, and seen once more
    assert np.sqrt(np.mean(np.square(errors).sum(1))) < 0.008  # bound: 0.0055
    # the next agent parks what it inherits and can't see, and goes on
    next_one = gs.GridSlam(scene, seed=42, prior_map=slam.map())
    for scan, own in zip(gs.simulate(scene, "agent1", seed=42), range(12), strict=False):
        estimate = next_one.step(scan)
        assert np.linalg.norm(estimate.position_m - scans.truth.position_m[own]) < 0.1
    assert len(next_one.state.parked) >= 8
    assert estimate.detected.sum() >= 0.85 * len(last)


def found(truth, estimate):
    """Number of the surface found for each true wall, within 0.5 m of its feature vector."""
    table = estimate.surfaces.take(estimate.detected)
    far = np.linalg.norm(truth.feature[:, None] - table.sfv_m[None], axis=-1)
    wall, row = linear_sum_assignment(np.minimum(far, 1.0))
    good = far[wall, row] < 0.5
    return dict(zip(wall[good].tolist(), table.identity[row[good]].tolist(), strict=True))
