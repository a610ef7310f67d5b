"""Association against enumeration, cell messages against enumeration, geometry, belief, bounds."""

import itertools

import numpy as np
import pytest
from enumeration import enumerate_marginals, random_association
from filter_states import Plot, sighting, small
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import norm

import gridslam as gs
from gridslam.evaluation.bounds import known_map_bound
from gridslam.inference.beliefs.belief import Belief, separated, update
from gridslam.inference.beliefs.layout import AGENT
from gridslam.inference.beliefs.particles import (
    BIN_M,
    DIVERGENCE,
    PORTION,
    Cloud,
    Particles,
    Sampling,
    draft_of,
    needed,
)
from gridslam.inference.messages.association import associate
from gridslam.inference.messages.cells import cast_messages
from gridslam.inference.state import path_messages as messages_module
from gridslam.inference.state.path_messages import PathMessages
from gridslam.inference.state.rays import Rays
from gridslam.kernels import PATH_BLOCK

angles, offsets = st.floats(-3, 3), st.floats(0.5, 20)
places = st.tuples(st.floats(-20, 20), st.floats(-20, 20)).map(np.array)


@given(st.integers(0, 10_000))
@settings(max_examples=30, deadline=None)
def test_association_is_exact_on_a_tree_and_close_to_enumeration_otherwise(seed):
    draw = np.random.default_rng(seed)
    paths, measured = draw.integers(1, 4, 2)
    beta, missed, new = random_association(draw, paths, measured, 0.6)
    nu, _ = associate(beta, missed, new)
    weight = beta * nu
    found = weight / (missed[:, None] + weight.sum(1, keepdims=True))
    tree = paths == 1 or measured == 1
    np.testing.assert_allclose(found, enumerate_marginals(beta, missed, new), atol=1e-5 if tree else 0.2)


def test_association_survives_no_paths_and_no_measurements():
    assert associate(np.zeros((0, 2)), np.zeros(0), np.ones(2))[0].shape == (0, 2)
    assert associate(np.zeros((2, 0)), np.ones(2), np.zeros(0))[0].shape == (2, 0)


@pytest.mark.parametrize("rank", [0, 3, 9])
def test_the_root_of_a_covariance_is_triangular_and_gives_it_back_even_if_singular(rank):
    draw = np.random.default_rng(rank)
    part = np.zeros((9, 9))
    part[:, :rank] = draw.normal(size=(9, rank))
    belief = Belief(np.zeros(9), part @ part.T)
    assert not np.triu(belief.root, 1).any()
    np.testing.assert_allclose(belief.root @ belief.root.T, belief.covariance, atol=1e-9)


def test_update_of_a_sure_association_is_the_kalman_update():
    draw = np.random.default_rng(1)
    root = draw.normal(size=(5, 5))
    belief = Belief(np.zeros(5), root @ root.T)
    jacobian, noise, residual = draw.normal(size=(2, 5)), np.array([0.3, 0.7]), np.array([0.2, -0.1])
    after = update(belief, jacobian, residual[None], noise[None], np.ones(1))
    information = np.linalg.inv(belief.covariance) + jacobian.T @ np.diag(1 / noise) @ jacobian
    np.testing.assert_allclose(after.covariance, np.linalg.inv(information), rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(after.mean, after.covariance @ jacobian.T @ (residual / noise), rtol=1e-6)
    np.testing.assert_allclose(update(belief, jacobian, residual[None], noise[None], np.zeros(1)).mean, 0)


def cell_messages(plot, bounces, anchor, agent, line, worth):
    """Tell the cells of one path at one state, and fold that in; return its V."""
    rays = Rays.of(*(np.array([value]) for value in (0, bounces, bounces - 1, bounces - 1, 1.0, 1.0)))
    cloud = Cloud(np.array([[*agent, 0.0, np.cos(line[0]), np.sin(line[0]), line[1]]]).T, 0.0)
    validity = plot.tell(rays, Sampling.at(cloud), [[*anchor, 0.0]], worth)
    plot.fold_messages()
    return validity[0]


def ray_messages(plot, through, hits, worth):
    """Twin by enumeration: exact log ratio of every touched cell, over all states of the path's cells."""
    touched = through + hits
    traversed = plot.cells.occupancy(plot.grid)[0].reshape(plot.grid.shape)
    log = {}
    for cell in touched:
        others = [c for c in touched if c != cell]
        value = []
        for own in (0, 1):
            total = 0.0
            for states in itertools.product((0, 1), repeat=len(others)):
                held = dict(zip(others, states, strict=True), **{})
                held[cell] = own
                valid = not any(held[c] for c in through) and (not hits or any(held[c] for c in hits))
                chance = np.prod([traversed[c] if held[c] else 1 - traversed[c] for c in others])
                total += chance * (worth if valid else 1.0)
            value.append(total)
        log[cell] = np.log(value[1]) - np.log(value[0])
    return log


@pytest.mark.slow
@pytest.mark.parametrize("worth", [0.1, 1.0, 30.0])
@pytest.mark.parametrize("bounces", [0, 1])
def test_cell_messages_equal_enumeration_of_all_cell_states(worth, bounces):
    plot = Plot((5, 6))
    plot.believe(np.random.default_rng(3).normal(0, 1, (5, 6)))
    anchor, agent, point = np.array([0.5, 0.5]), np.array([4.5, 0.5]), np.array([2.5, 3.5])
    corners = np.stack([anchor, point, agent, agent] if bounces else [anchor, agent, agent, agent])
    walked = set()
    for start, end in itertools.pairwise(corners[: bounces + 2]):
        for share in np.linspace(0, 1, 20_001):
            x, y = start + share * (end - start)
            walked.add((int(np.floor(y)), int(np.floor(x))))
    hits = [(2, 2), (3, 2), (4, 2)] if bounces else []
    through = sorted(walked - set(hits))
    # the corner cells that a sampled walk may graze don't count
    before = plot.grid.evidence
    expected = ray_messages(plot, through, hits, worth)
    cell_messages(plot, bounces, anchor, agent, (np.pi / 2, 3.5), worth)
    change = plot.grid.evidence - before
    for cell, value in expected.items():
        assert change[cell] == pytest.approx(value, rel=1e-5, abs=1e-6)
    untouched = np.ones(before.shape, dtype=bool)
    untouched[tuple(np.array(through + hits).T)] = False
    assert not change[untouched].any()


def test_a_ray_outside_the_grid_touches_nothing():
    plot = Plot((3, 3))
    assert cell_messages(plot, 0, (5.0, 5.0), (9.0, 7.0), (0.0, 1.0), 5.0) == 1.0
    assert not plot.grid.evidence.any()


def test_the_bound_is_positive_and_below_the_prior():
    scene = gs.Scene.load("room")
    bound = known_map_bound(scene, "agent1")
    assert (bound.position_m > 0).all()
    assert bound.position_m.max() < 0.1


@given(st.integers(0, 4), st.integers(0, 2**32 - 1))
@settings(max_examples=30, deadline=None)
def test_separated_beliefs_keep_their_marginals_and_nothing_between(surfaces, seed):
    draw = np.random.default_rng(seed)
    size = AGENT + 2 * surfaces
    root = draw.normal(size=(size, size))
    joint = Belief(draw.normal(size=size), root @ root.T)
    apart = separated(joint)
    blocks = [slice(0, AGENT)] + [slice(AGENT + 2 * n, AGENT + 2 * n + 2) for n in range(surfaces)]
    left = apart.covariance.copy()
    for block in blocks:
        np.testing.assert_array_equal(left[block, block], joint.covariance[block, block])
        left[block, block] = 0
    assert not left.any()
    np.testing.assert_array_equal(apart.mean, joint.mean)


def test_adapted_particles_grow_with_the_spread_of_the_pose_and_keep_within_bounds():
    counts = []
    for std in (1e-4, 0.02, 0.1, 0.2, 0.5, 5.0):
        particles = Particles(20_000, seed=1, adapt=True)
        belief = Belief(np.zeros(5), np.diag(np.square([std, std, 1, 1, 0.01])))
        count, kept = particles.ask(belief)
        counts.append(count)
        assert count % PATH_BLOCK == 0
        used = particles.points(belief)[:, :count].astype(np.float64)
        np.testing.assert_allclose(used.mean(1), 0, atol=1e-6)
        np.testing.assert_allclose(used.std(1), 1, atol=1e-6)
        assert 0 < kept < 0.2
    assert counts == sorted(counts)
    assert counts[0] == PORTION
    assert PORTION < counts[2] < counts[3] < particles.count
    assert counts[-1] == particles.count
    assert Particles(20_000, seed=1).ask(belief)[0] == particles.count


def test_divergence_of_binned_samples_keeps_below_what_their_number_is_for():
    draw, over = np.random.default_rng(2), 0
    std = np.array([0.12, 0.12, 0.01])
    belief = Belief(np.zeros(5), np.diag([*std[:2] ** 2, 1, 1, std[2] ** 2]))
    number = int(np.ceil(needed(belief)))
    edges = [np.arange(-60.5, 61) * BIN_M] * 2
    share = np.diff(norm.cdf(edges[0] / std[0]))
    truth = np.outer(share, share)  # the heading lies within one bin
    for _ in range(100):
        counts, *_ = np.histogram2d(*(std[:2, None] * draw.normal(size=(2, number))), edges)
        seen = counts / number
        over += (seen[seen > 0] * np.log(seen[seen > 0] / truth[seen > 0])).sum() > DIVERGENCE
    assert over <= 5  # one is expected


@pytest.mark.parametrize("worth", [1.0, 1 + 1e-12, 3.0])
def test_worthless_paths_tell_cells_nothing_and_never_list_more_than_there_are(worth):
    plot = Plot((8, 8), 5.0, anchors=[[1.0, 1.0]])
    draw, surfaces, rays = np.random.default_rng(1), 6, 48
    state = np.empty((3 + 3 * surfaces, rays))
    state[:3] = np.array([[6.0, 5.0, 0.0]]).T + 0.3 * draw.normal(size=(3, rays))
    angle = np.linspace(0, 2 * np.pi, surfaces, endpoint=False)[:, None] + 0.05 * draw.normal(
        size=(surfaces, rays)
    )
    state[3::3], state[4::3], state[5::3] = np.cos(angle), np.sin(angle), 7.5
    last, first = (a.ravel() for a in np.indices((surfaces, surfaces)))
    whole = np.ones(len(last))
    paths = Rays.of(0 * last, np.where(last == first, 1, 2), last, first, whole, whole)
    touched = plot.cells.scratch.touched
    touched[...] = -7
    plot.tell(paths, Sampling.at(Cloud(state, 0.0)), [[1.0, 1.0, 0.0]], worth)
    assert (touched[1::2, -1] == -7).all(), "the list of cells that are met is never full"
    plot.fold_messages()
    assert plot.grid.observed.any() == (worth == 3.0)


def test_messages_of_an_interrupted_step_are_forgotten_by_the_next():
    plot, other = small(), small()
    sighting(plot)
    plot.work.begin()
    plot.fold_messages()
    assert not plot.grid.evidence.any()
    for one in (plot, other):
        one.work.begin()
        sighting(one)
        one.fold_messages()
    assert plot.grid.evidence.any()
    np.testing.assert_array_equal(plot.grid.evidence, other.grid.evidence)


def test_occupancy_follows_whichever_grid_it_is_asked_of_and_a_step_that_was_interrupted(monkeypatch):
    from gridslam.kernels.propagation import occupancy

    plot = small()
    sighting(plot)
    plot.fold_messages()
    first = plot.state
    before = plot.cells.occupancy(plot.grid).copy()
    plot.believe(np.full((4, 4), 0.5))
    set_so, known, fold_messages = plot.cells.occupancy(plot.grid).copy(), plot.grid, occupancy.fold_messages
    np.testing.assert_allclose(set_so[1, 1:], 1 / (1 + np.exp(-0.5)), rtol=1e-5)  # but for the anchor's own

    def interrupted(*arguments):
        fold_messages(*arguments)
        raise KeyboardInterrupt

    sighting(plot)
    with monkeypatch.context() as patch:
        patch.setattr(occupancy, "fold_messages", interrupted)
        with pytest.raises(KeyboardInterrupt):
            plot.fold_messages()
    assert plot.grid is known
    np.testing.assert_array_equal(plot.cells.occupancy(plot.grid), set_so)
    plot.state = first
    np.testing.assert_array_equal(plot.cells.occupancy(plot.grid), before)


def test_messages_stay_when_capacity_grows_and_there_is_never_any_where_none_are_kept():
    messages, draw = PathMessages(), np.random.default_rng(1)
    messages.reserve(3, 5, (1, 2))
    messages.count[:] = 3, 5
    for array in messages.block()[1:]:
        array[...] = draw.integers(1, 99, array.shape)
    messages.begin[0] = 0
    before = [array.copy() for array in messages.block()]
    messages.reserve(2, 2, (4, 1))
    np.testing.assert_array_equal(messages.path, before[1])
    messages.reserve(500, 700, (0, 0))
    count, path, factor, summary, begin, pairs = messages.block()
    assert messages.among == (4, 2)
    assert len(path) == len(factor) == summary.shape[1] == len(begin) - 1 >= 503
    assert pairs.shape[1] >= 705
    found = count, path[:3], factor[:3], summary[:, :3], begin[:4], pairs[:, :5]
    wanted = before[0], before[1][:3], before[2][:3], before[3][:, :3], before[4][:4], before[5][:, :5]
    for now, then in zip(found, wanted, strict=True):
        np.testing.assert_array_equal(now, then)
    assert all(array.flags.c_contiguous for array in messages.block())
    none = PathMessages(records=False)
    none.reserve(3, 5, (1, 2))
    assert not len(none.path)


def test_messages_of_other_surfaces_or_anchors_are_refused():
    plot = small()
    plot.work.messages.reserve(3, 5, (4, 1))
    with pytest.raises(ValueError, match="surfaces or anchors"):
        cast_messages(plot.state, plot.model, work=plot.work)


def test_capacity_for_messages_is_there_after_whatever_interrupted_its_making(monkeypatch):
    real, left = messages_module._longer, 3
    monkeypatch.setattr(messages_module, "_longer", lambda *given: real(*given) if next(left) else 1 / 0)
    for before in range(5):
        left, messages = itertools.chain([1] * before, [0], itertools.repeat(1)), PathMessages()
        with pytest.raises(ZeroDivisionError):
            messages.reserve(3, 5, (1, 1))
        messages.reserve(3, 5, (1, 1))
        assert min(len(messages.path), len(messages.factor), messages.summary.shape[1]) >= 3
        assert len(messages.begin) >= 4
        assert messages.pairs.shape[1] >= 5


@pytest.mark.parametrize(("particles", "anchors"), [(32, 3), (192, 4), (384, 8), (10_016, 4)])
def test_samples_are_spread_evenly_over_the_points_whatever_the_number_of_anchors(particles, anchors):
    cloud, belief = Particles(particles, seed=1), Belief(np.zeros(5), np.eye(5))
    draft = draft_of(belief.layout, 48)
    firsts = [cloud.samples(belief, anchors * step + 1, draft).first for step in range(4 * particles)]
    assert min(firsts) == 0
    assert max(firsts) == particles - 1
    count = np.bincount(firsts, minlength=particles)
    # for a sequence by the golden ratio and its multiples, parts and their share differ by little
    assert np.abs(np.cumsum(count) / len(firsts) - np.arange(1, particles + 1) / particles).max() < 0.05
    sample = cloud.samples(belief, 1, draft)
    assert sample.first != cloud.samples(belief, 2, draft).first
    assert sample.draft.state.shape == (3, 48)


def test_rays_of_surfaces_or_anchors_that_are_not_there_are_refused():
    one = np.ones(1)
    bounce, sight = Rays.of(0, 1, 2, 2, one, one), Rays.of(1, 0, -1, -1, one, one)
    two = np.arange(2)
    both = Rays.of(two, 1 - two, [2, -1], [2, -1], np.ones(2), np.ones(2))
    both.check(3, 2)
    both.check(3)  # by a kernel that looks at no anchor
    for rays in (bounce, both, Rays(sight.table, one, one, (3, 2))):
        with pytest.raises(ValueError, match="surface"):
            rays.check(2, 2)
    for rays in (sight, both):
        with pytest.raises(ValueError, match="anchor"):
            rays.check(3, 1)
