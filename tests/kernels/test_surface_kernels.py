"""Kernels that list rays, propose births and tidy surfaces, against their twins."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from kernel_worlds import (
    BINS,
    SEEDS,
    UNKNOWN,
    random_bank,
    random_belief,
    random_hits,
    random_places,
    random_radio,
    random_table,
    random_world,
)

from gridslam import reference
from gridslam.inference.messages.birth_proposals import SAMPLES
from gridslam.kernels import TAKE_ROOT
from gridslam.kernels.primitives.blocks import (
    Belief,
    BirthRows,
    Description,
    Draft,
    Links,
    Listed,
    Query,
    Sketch,
    SurfaceRows,
)
from gridslam.kernels.primitives.tables import PREDICTED
from gridslam.world.geometry import line_between, mirror, wrap

clocks = st.sampled_from([0, 2])
ANGLES = {"both": (0.3, 0.0), "AoA": (-1.0, 0.0), "AoD": (0.0, -1.0)}
"""Columns of a table that say which angles were measured, and how well."""


@given(SEEDS, st.integers(0, 4), st.integers(0, 2), st.sampled_from([-1, 0, 1]), UNKNOWN)
@settings(max_examples=60, deadline=None)
def test_rays_and_their_prediction_equal_their_twin(seed, surfaces, bounces, only, unknown):
    from gridslam.kernels.propagation.rays import list_paths

    (clocks, rises), draw, anchors = unknown, np.random.default_rng(seed), 2
    mean, covariance, _ = random_belief(draw, surfaces, clocks, rises)
    surface, owner, _, sight, single, double = random_bank(draw, surfaces, anchors)
    change = (0.95, 0.005) if only >= 0 else (1.0, 0.0)
    senders = 2 if only == 1 else int(draw.integers(1, 3))  # the second anchor may be the first one's image
    bank = surface, owner, sight, single, double
    query = Query(
        np.array([only, bounces, 5 + clocks, 0, TAKE_ROOT, senders], np.int32), np.array([*change, 0.9])
    )
    into = query, Belief(mean, covariance), random_places(draw, anchors, rises), Links(*bank)
    room = anchors * (1 + surfaces**2)
    path, existence, together = np.zeros((room, 4), np.int32), np.zeros(room), np.zeros(room)
    predicted, found = np.zeros((room, PREDICTED)), np.zeros(1, np.int32)
    size, samples = len(mean), 3
    points, whole = draw.normal(size=(size, samples)).astype(np.float32), np.full((size, size), np.nan)
    root, base = np.full((size, size), np.nan, np.float32), np.full((size, 3), np.nan, np.float32)
    state, failed = np.full((3 + 3 * surfaces + clocks, samples), np.nan), np.full(1, 9, np.int32)
    drafts = whole, root, base, state
    out = Listed(path, existence, together, predicted, found)
    list_paths(*into, Draft(points, *drafts, failed), out)
    assert failed[0] == 0
    for draft, wanted in zip(
        drafts, reference.prepare(mean, covariance, 5 + clocks, 0.9, points.astype(float)), strict=True
    ):
        np.testing.assert_allclose(draft, wanted, rtol=1e-5, atol=1e-6)
    count = int(found[0])
    rays, own, both, whole = reference.list_paths(*into)
    np.testing.assert_array_equal(path[:count], rays)
    np.testing.assert_allclose(existence[:count], own, rtol=1e-6)
    np.testing.assert_allclose(together[:count], both, rtol=1e-9)
    far = whole[:, 12] > 0.1  # next to its image, an agent has no direction to it
    predicted = predicted[:count][far]
    np.testing.assert_allclose(predicted[:, 0], whole[far, 0], rtol=1e-9)
    np.testing.assert_allclose(wrap(predicted[:, 1:3] - whole[far, 1:3]), 0, atol=1e-6)
    np.testing.assert_allclose(predicted[:, 3:], whole[far, 3:], rtol=1e-6, atol=1e-9)


@given(SEEDS, st.integers(0, 3), st.booleans(), UNKNOWN)
@settings(max_examples=60, deadline=None)
def test_loud_measurements_near_a_path_equal_their_twin(seed, surfaces, given_std, unknown):
    from gridslam.kernels.propagation.rays import near

    (clocks, rises), draw, anchors = unknown, np.random.default_rng(seed), 2
    mean, covariance, _ = random_belief(draw, surfaces, clocks, rises)
    head, bank = 5 + clocks, random_bank(draw, surfaces, anchors)
    places = random_places(draw, anchors, rises)
    links = Links(*bank[:2], *bank[3:])
    query = Query(np.array([-1, 1, head, 0, 0, 1], np.int32), np.array([1.0, 0.0, 1.0]))
    _, _, _, predicted = reference.list_paths(query, Belief(mean, covariance), places, links)
    scan = random_table(draw, int(draw.integers(0, 8)), predicted[:, :3], draw.choice([0.01, 0.4]))
    radio = random_radio(draw, given_std)
    claimed = np.full(len(scan), -1, np.int32)
    into = mean, covariance, head, places, *bank[:2], scan, radio
    near(*into, claimed)
    np.testing.assert_array_equal(claimed, reference.near(*into))


@given(SEEDS, st.sampled_from([*ANGLES]), st.sampled_from([SAMPLES // 2, SAMPLES, 2 * SAMPLES]), UNKNOWN)
@settings(max_examples=40, deadline=None)
def test_birth_proposals_equal_their_twin(seed, angles, particles, unknown):
    from gridslam.kernels.management.births import propose

    (clocks, rises), draw, count = unknown, np.random.default_rng(seed), 5
    state, _, place = random_world(draw, particles, np.float32, surfaces=2)
    places, radio = np.stack([random_places(draw, 1)[0], place.astype(np.float64)]), random_radio(draw)
    places[:, 5] = draw.integers(0, 2, 2) if rises else -1
    mean = np.concatenate([state[:2, 0], [0.0, 0.0], state[2:3, 0], reference.lines_of(state)[:, 0].ravel()])
    late = draw.uniform(-3, 3, clocks)  # longer than some distances
    mean = np.insert(mean.astype(np.float64), 5, late)
    spread = (late[:, None] + 0.05 * draw.normal(size=(clocks, particles))).astype(np.float32)
    state, head = np.concatenate([state, spread]), 5 + clocks
    scan = random_table(draw, count)
    scan[1:, 4:6] = ANGLES[angles]
    known = np.array([[-1, -1], [-1, 0], [0, -1], [1, -1], [-1, 1]], np.int32)[: draw.choice([0, 1, 5])]
    noise, measured = draw.normal(size=(2, SAMPLES)), np.full((5, count), 7.0)
    measured[0] = draw.choice([0.0, 1.0, 1e4], count)
    whose = np.array([[1], [0, 1]][draw.integers(2)], np.int32)
    into = state, noise, mean, head, scan, known, whose, places, radio, 0.1 / (4 * np.pi * 8)
    expected, lines = reference.propose(*into, measured)
    born, proposal = np.full((1 + expected.size, 4), -9, np.int32), np.full((expected.size, 3), np.nan)
    names = "state", "noise", "mean", "head", "scan", "known", "whose", "places", "radio", "rate"
    given = dict(zip(names, into, strict=True))
    propose.named(**given, ratio=np.empty(expected.shape), measured=measured, born=born, proposal=proposal)
    born, proposal = born[1 : 1 + born[0, 0]], proposal[: born[0, 0]]
    ratio, line = np.zeros(expected.shape), np.zeros((*expected.shape, 2))
    every = [(*pair, anchor) for anchor in whose.tolist() for pair in known.tolist()]
    column = [every.index(tuple(row)) for row in born[:, 1:].tolist()]
    ratio[born[:, 0], column], line[born[:, 0], column] = proposal[:, 2], proposal[:, :2]
    np.testing.assert_allclose(measured[2], 1 + ratio.sum(1))
    sure = (
        np.abs(expected - np.maximum(1e-3, 1e-3 * measured[0])[:, None]) > 1e-4
    )  # not next to what is dropped
    np.testing.assert_allclose(ratio[sure], expected[sure], rtol=1e-2, atol=2e-3)
    both = (ratio > 0) & (expected > 0)
    turned = np.cos(line[both][:, 0] - lines[both][:, 0])  # one line has two normals
    np.testing.assert_allclose(np.abs(turned), 1, atol=1e-6)
    np.testing.assert_allclose(np.sign(turned) * line[both][:, 1], lines[both][:, 1], atol=1e-5)


@given(SEEDS, st.integers(0, 3), clocks)
@settings(max_examples=40, deadline=None)
def test_a_glance_at_births_equals_its_twin(seed, surfaces, clocks):
    from gridslam.kernels.management.birth_visibility import weigh_by_visibility
    from gridslam.kernels.propagation.bundles import LANES, LINES, PLACES

    draw = np.random.default_rng(seed)
    mean, _, _ = random_belief(draw, surfaces, clocks)
    places, shape = random_places(draw, 2), (17, 23)
    occupied = draw.uniform(0.001, 0.5, (2, shape[0] * shape[1])).astype(np.float32)
    frame = np.array(
        [-4.0, -3.0, 0.41, 0.1, 12.0, 0.0, 0.05, draw.choice([0.0, 0.2, 0.5])]
    )  # much is outside
    hit = np.array([[-1, -1]] * 3 + [p for s in range(surfaces) for p in ((-1, s), (s, -1))], np.int32)
    count = len(hit)
    measurement = draw.integers(0, 4, count)
    whose = draw.integers(0, 2, count)
    born = np.concatenate([[[count, 0, 0, 0]], np.column_stack([measurement, hit, whose])]).astype(np.int32)
    proposal = np.column_stack(
        [draw.uniform(-3, 3, count), draw.uniform(-5, 5, count), draw.exponential(1.0, count)]
    )
    measured = np.full((4, 4), 7.0)
    into = mean, 5 + clocks, places, shape[1], occupied, frame
    expected = reference.weigh_by_visibility(*into, born, proposal)
    sketch = Sketch(
        np.empty((1, LINES, LANES)), np.empty((1, PLACES, LANES), np.int32),
        np.empty((6 + 3 * surfaces, 1)), np.empty((1, 4), np.int32), np.empty((1, 14)),
    )  # fmt: skip
    mean, head, places, wide, *grid = into
    weigh_by_visibility(
        head, wide, mean, places, *grid, sketch, BirthRows(np.empty((0, 0)), born, proposal), measured
    )
    np.testing.assert_allclose(proposal[:, 2], expected, rtol=1e-5)
    np.testing.assert_allclose(measured[2], 1 + np.bincount(measurement, proposal[:, 2], 4))
    np.testing.assert_array_equal(measured[[0, 1, 3]], 7.0)


@given(SEEDS, st.integers(0, 5), clocks)
@settings(max_examples=80, deadline=None)
def test_duplicates_equal_their_twin(seed, surfaces, clocks):
    from gridslam.kernels.management.merging import find_duplicates

    draw = np.random.default_rng(seed)
    mean, covariance, _ = random_belief(draw, surfaces, clocks)
    head = 5 + clocks
    lines = mean[head:].reshape(-1, 2)
    foot, owner = draw.uniform(-3, 3, surfaces), draw.choice([-1, 0], surfaces).astype(np.int64)
    apart = (draw.random((surfaces, surfaces)) < 0.2).astype(np.uint8)
    for copy in range(1, surfaces, 2):  # nearly one line with the one before, maybe by its opposite normal
        lines[copy] = lines[copy - 1] + 0.1 * draw.normal(size=2)
        if draw.random() < 0.5:
            lines[copy] = wrap(lines[copy, 0] + np.pi), -lines[copy, 1]
    found, tie = np.full(2, -9, np.int32), np.full((2, 5), np.nan)
    find_duplicates(mean, covariance, head, foot, owner, apart, found, tie)
    expected = reference.find_duplicates(mean, covariance, head, foot, owner, apart)
    if expected is None:
        assert found.tolist() == [-1, -1]
        return
    older, younger, jacobian, residual = expected
    assert found.tolist() == [older, younger]
    entry = head + np.array([2 * older, 2 * older + 1, 2 * younger, 2 * younger + 1])
    np.testing.assert_allclose(tie[:, :4], jacobian[:, entry], atol=1e-6)
    np.testing.assert_allclose(tie[:, 4], residual, atol=1e-6)


@given(SEEDS, st.integers(2, 6), clocks)
@settings(max_examples=80, deadline=None)
def test_ghosts_equal_their_twin(seed, surfaces, clocks):
    from gridslam.kernels.management.merging import find_ghosts

    draw, anchors = np.random.default_rng(seed), 2
    mean, covariance, _ = random_belief(draw, surfaces, clocks)
    existence, _, _, _, single, _ = random_bank(draw, surfaces, anchors)
    covariance *= draw.choice([0.01, 1.0, 30.0])
    places, seen = random_places(draw, anchors)[:, :2].copy(), draw.choice([3, 12, 60], surfaces)
    existence[:2], seen[:2], single[:] = 0.999, 60, draw.choice([0.05, 0.9], single.shape, p=[0.8, 0.2])
    lines = mean[5 + clocks :].reshape(-1, 2)
    for ghost in range(2, surfaces):  # at or near where the double bounce of the first two seems to come from
        image = mirror(lines[0], mirror(lines[1], places[0]))
        line = line_between(places[0], image + draw.choice([0.0, 0.1, 0.6]) * draw.normal(size=2))
        lines[ghost] = line
        existence[ghost] = draw.choice([0.5, 0.99])
    ghosts = np.full(surfaces, -1, np.int32)
    age = draw.choice([0.0, 20.0, 60.0], surfaces)
    into = (
        mean,
        covariance,
        5 + clocks,
        existence,
        seen.astype(np.int64),
        age,
        single,
        places,
        draw.choice([0.0, 2.0]),
    )
    find_ghosts(*into, ghosts)
    np.testing.assert_array_equal(ghosts, reference.find_ghosts(*into))


@given(SEEDS, st.integers(0, 4), st.integers(0, 12), clocks)
@settings(max_examples=60, deadline=None)
def test_sightings_of_surfaces_equal_their_twin(seed, surfaces, paths, clocks):
    from gridslam.kernels.propagation.detections import mark

    draw = np.random.default_rng(seed)
    mean, bounces = (
        draw.normal(0, 3, 5 + clocks + 2 * surfaces),
        draw.integers(0, min(surfaces, 2) + 1, paths),
    )
    last, first = draw.integers(0, max(surfaces, 1), (2, paths))
    first = np.where(bounces == 1, last, np.where(first == last, (last + 1) % max(surfaces, 1), first))
    path = np.stack([bounces, last, first, np.sort(draw.integers(0, 3, paths))], -1).astype(np.int32)
    path[bounces == 0, 1:3] = -1
    seen, share = draw.normal(0, 4, (paths, 6)), draw.uniform(0, 1.2, paths)
    seen[:, 1] = draw.choice([0.0, 0.7, 1.0], paths)
    sights, places = random_hits(draw, surfaces), draw.normal(0, 4, (3, 6))
    expected = reference.mark(mean, 5 + clocks, path, seen, share, places, *sights)
    mark(mean, 5 + clocks, path, seen, share, places, np.full(surfaces, 9, np.int32), sights)
    for found, wanted in zip(sights, expected, strict=True):
        np.testing.assert_allclose(found, wanted, rtol=1e-6, atol=1e-6)


@given(SEEDS, st.integers(0, 5), UNKNOWN)
@settings(max_examples=60, deadline=None)
def test_what_users_are_told_equals_its_twin(seed, surfaces, unknown):
    from gridslam.kernels.management.readout import describe

    (clocks, rises), draw, anchors = unknown, np.random.default_rng(seed), 2
    mean, covariance, _ = random_belief(draw, surfaces, clocks, rises)
    mean[5 + clocks :: 2] += draw.choice([-7.0, 0.0, 9.0], surfaces)  # angles aren't kept wrapped
    mean[6 + clocks :: 2] *= draw.choice([-1, 1], surfaces)
    existence, owner, _, sight, single, double = random_bank(draw, surfaces, anchors)
    places = random_places(draw, anchors, rises)
    extent = draw.choice([np.nan, 1.0], (surfaces, 1)) * np.sort(draw.normal(size=(surfaces, 2)))
    single[:, ::2], double[:, ::2] = 0.9, 0.95
    head, reflection = 5 + clocks, draw.dirichlet(np.ones(BINS), surfaces)
    links, room = Links(existence, owner, sight, single, double), 1 + anchors * (1 + surfaces**2)
    rows = SurfaceRows(extent, reflection, draw.permutation(surfaces).astype(np.int64))
    into = head, 2, 5.0, Belief(mean, covariance), places, links, rows
    table, path = np.full((surfaces, 16), np.nan), np.full((room, 4), -9, np.int32)
    number, described, found = np.full((room, 3), -9), np.full((room, 13), 9.0), np.full(1, -9, np.int32)
    drawn, scratch = np.full((room, 13), np.nan), np.full((3 + 3 * surfaces, 1), np.nan)
    describe(*into, Description(scratch, table, path, drawn, number, described, found))
    wanted, paths, numbers, values = reference.describe(*into)
    np.testing.assert_allclose(table[:, 1:], wanted[:, 1:], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(wrap(table[:, 0] - wanted[:, 0]), 0, atol=1e-12)
    assert (np.abs(table[:, 0]) <= np.pi + 1e-12).all()
    count = found[0]
    np.testing.assert_array_equal(path[:count], paths)
    np.testing.assert_array_equal(number[:count], numbers)
    late = reference.late(mean, head, paths[:, 3], places)
    far = values[:, 0] - late > 0.1  # next to its image, an agent has no direction to it
    np.testing.assert_allclose(described[:count, :3][far], values[far, :3], rtol=1e-6, atol=4e-6)
    np.testing.assert_allclose(described[:count, 3:5], values[:, 3:5], rtol=1e-6)
    np.testing.assert_allclose(described[:count, 5:], values[:, 5:], rtol=1e-9, atol=1e-9)
