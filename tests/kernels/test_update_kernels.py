"""Kernels that correct the belief by the paths of an anchor, against their twins."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from kernel_worlds import (
    SEEDS,
    UNKNOWN,
    predicted_of,
    random_bank,
    random_belief,
    random_places,
    random_radio,
    random_table,
)

from gridslam import reference
from gridslam.bench.kernels import twin_arguments
from gridslam.kernels import PATH_BLOCK, SUMS
from gridslam.world.geometry import wrap


@pytest.mark.slow
@given(SEEDS, st.integers(0, 3), st.sampled_from([0, 100]), st.booleans(), UNKNOWN)
@settings(max_examples=60, deadline=None)
def test_updates_equal_their_twin(seed, surfaces, rounds, noted, unknown):
    from gridslam.kernels.messages.updates import update, update_with_clocks, update_with_rises

    draw, (clocks, rises) = np.random.default_rng(seed), unknown
    mean, covariance, path = random_belief(draw, surfaces, clocks, rises)
    places = random_places(draw, 2, rises)
    path[:, 3] = np.sort(draw.integers(0, 2, len(path)))
    predicted = predicted_of(mean, covariance, 5 + clocks, path, places)
    far = predicted[:, 12] > 0.5  # next to its image, an agent has no direction to it
    path, predicted = path[far], predicted[far]
    value = predicted[:, :3]
    count, anchors = 4, 2
    chosen = np.argwhere(draw.random((len(path), count)) < 0.4).astype(np.int32)
    start = np.searchsorted(chosen[:, 0], np.arange(len(path) + 1)).astype(np.int32)
    pair = np.ones((len(chosen), 8))
    pair[:, :3] = value[chosen[:, 0]] + 0.1 * draw.normal(size=(len(chosen), 3))
    pair[:, 3:6] = np.where(draw.random((len(chosen), 3)) < 0.2, 1e12, 0.01)
    pair[:, 6] = draw.exponential(10.0 ** draw.integers(-2, 3), len(chosen))
    message = np.zeros((5, len(path), count))
    message[:2, chosen[:, 0], chosen[:, 1]] = draw.exponential(1.0, (2, len(chosen)))
    message[3] = draw.uniform(0.2, 1, (len(path), count))
    odds, measured = draw.uniform(0.05, 0.95, (12, len(path))), draw.uniform(0, 1, (5, count))
    measured[2] = 1 + draw.exponential(1.0, count)
    scan = random_table(draw, count)
    blocks = draw.uniform(0, PATH_BLOCK, (len(path) + len(chosen), 3)).astype(np.float32)
    surface, _, _, sight, single, double = random_bank(draw, surfaces, anchors)
    sums = draw.uniform(0, 1, (anchors, SUMS))
    sums[:, -1] = 150.0
    into = {
        "mean": mean, "covariance": covariance, "head": 5 + clocks, "path": path, "start": start,
        "index": chosen, "pair": pair, "odds": odds, "rounds": rounds, "places": places,
        "predicted": predicted, "scan": scan, "blocks": blocks, "radio": random_radio(draw),
        "turned": np.array([-0.02, 0.01]),
    }  # fmt: skip
    messages = {"message": message, "measured": measured}
    kept = {"surface": surface, "sight": sight, "single": single, "double": double}
    rows, pairs = len(path), len(chosen)
    notes = {
        "count": np.array([2, 3], np.int32), "noted": np.full((rows + 4, 4), 7, np.int32),
        "factor": draw.normal(size=(rows + 4, 2)), "summary": draw.normal(size=(4, rows + 4)),
        "begin": np.full(rows + 5, 3, np.int32), "detection": draw.normal(size=(2, pairs + 5)),
    }  # fmt: skip
    if not noted:
        notes["noted"] = np.empty((0, 4), np.int32)
    out = {"share": np.full(len(chosen), np.nan), "sums": sums} | notes
    flat = into | messages | kept | out | {"scratch": np.empty((len(mean), 6))}
    expected = reference.update(**twin_arguments(reference.update, flat))
    launch = update_with_rises() if rises else update_with_clocks() if clocks else update
    launch.named(**flat)
    found = into | messages | kept | out
    found["worth"], found["total"] = odds[8], odds[11]
    for name, wanted in expected.items():
        # directions are worked out to 1e-6 rad: in means at most that, in densities times gap over variance
        rtol = 1e-4 if name in ("share", "message", "total") else 1e-5
        np.testing.assert_allclose(found[name], wanted, rtol=rtol, atol=1e-6, err_msg=name)
    assert np.linalg.eigvalsh(covariance).min() > -1e-9
    assert (surface < 1).all()


def test_equally_sure_paths_are_taken_as_they_stand():
    import taichi as ti

    from gridslam.kernels.primitives.corrections import sorted_by

    @ti.kernel
    def order_of(rank: ti.types.ndarray(dtype=ti.f64, ndim=2)) -> ti.i32:
        count = 0
        for _ in range(1):
            count = sorted_by(rank, 0.25, rank.shape[1])
        return count

    rank = np.full((12, 7), -1.0)
    rank[9] = [0.5, 0.1, 0.9, 0.5, 0.25, 0.9, 0.0]
    assert order_of(rank) == 5
    assert rank[10].tolist() == [2, 5, 0, 3, 4, -1, -1]


def test_effective_sample_size_is_all_of_equal_weights_and_follows_their_spread():
    draw, size = np.random.default_rng(1), reference.effective_sample_size
    assert size(np.full((1, 20), 7.0, np.float32)) == pytest.approx(20 * PATH_BLOCK)
    assert size(np.zeros((1, 20), np.float32)) == 20 * PATH_BLOCK
    # exponential weights: E[w]^2 / E[w^2] = 1 / 2; 4000 blocks tell their variance to 1 / sqrt(2000)
    blocks = draw.exponential(1.0, (1, 4000, PATH_BLOCK)).sum(2).astype(np.float32)
    assert size(blocks)[0] / (4000 * PATH_BLOCK) == pytest.approx(0.5, abs=0.5 * 4 / np.sqrt(2000))


@pytest.fixture(scope="module")
def bent():
    """A kernel that writes what `bend_of` says of a line of sight, its value and derivatives by x and y."""
    import taichi as ti

    from gridslam.kernels.primitives.gaussian import bend_of, path_of

    @ti.kernel
    def bent(
        mean: ti.types.ndarray(dtype=ti.f64, ndim=1),
        covariance: ti.types.ndarray(dtype=ti.f64, ndim=2),
        place: ti.types.ndarray(dtype=ti.f64, ndim=1),
        out: ti.types.ndarray(dtype=ti.f64, ndim=2),
    ):
        for _ in range(1):
            own = ti.Vector([place[0], place[1], place[2], 0.0, place[3]], dt=ti.f64)
            value, slope = path_of(mean, 5, own, 0, 0, 0)
            more, spread = bend_of(slope, value[0], covariance)
            for i in ti.static(range(3)):
                out[0, i], out[4, i] = more[i], value[i]
                for j in ti.static(range(3)):
                    out[1 + i, j] = spread[i, j]
                for j in ti.static(range(2)):
                    out[5 + i, j] = slope[i, j]

    return bent


@given(SEEDS, st.booleans())
@settings(max_examples=40, deadline=None)
def test_what_derivatives_leave_out_equals_its_twin_and_is_what_samples_show(bent, seed, high):
    draw = np.random.default_rng(seed)
    level, toward = draw.uniform(0.03, 6), draw.uniform(-np.pi, np.pi)
    place = np.array([*draw.normal(size=2), draw.uniform(-3, 3), 0.2 * high])
    mean = np.zeros(5)
    mean[:2] = place[:2] + level * np.array([np.cos(toward), np.sin(toward)])
    root = 0.03 * level * (np.eye(2) + 0.2 * draw.normal(size=(2, 2)))
    covariance = np.zeros((5, 5))
    covariance[:2, :2] = root @ root.T
    found = np.zeros((8, 5))
    bent(mean, covariance, place, found)
    more, spread = reference.bend(mean, covariance, place, place[3])
    np.testing.assert_allclose(found[0, :3], more, rtol=1e-4, atol=1e-9)
    np.testing.assert_allclose(found[1:4, :3], spread, rtol=1e-4, atol=1e-12)

    moved = (root @ draw.standard_normal((2, 20_000))).T
    away = mean[:2] + moved - place[:2]
    turn = np.angle(np.exp(1j * (np.arctan2(away[:, 1], away[:, 0]) - toward)))
    exact = np.stack([np.hypot(np.hypot(*away.T), place[3]), turn, turn], -1)
    exact[:, 0] -= np.hypot(level, place[3])
    rest = exact - moved @ found[5:8, :2].T
    scale = np.sqrt(np.diag(spread)) + 1e-12
    np.testing.assert_allclose(rest.mean(0) / scale, more / scale, atol=0.15)
    assert rest.std(0) / scale == pytest.approx(np.ones(3), abs=0.1)


def test_an_agent_at_its_anchors_very_place_has_no_direction_to_bend(bent):
    place, found = np.array([0.4, -0.3, 0.2, 0.0]), np.full((8, 5), np.nan)
    mean = np.array([0.4, -0.3, 0.0, 0.0, 0.0])
    bent(mean, 0.01 * np.eye(5), place, found)
    more, spread = reference.bend(mean, 0.01 * np.eye(5), place, place[3])
    assert not found[:4, :3].any()
    assert not more.any()
    assert not spread.any()


@pytest.fixture(scope="module")
def bounced():
    """The same of a single bounce over a line; derivatives by x, y and the line."""
    import taichi as ti

    from gridslam.kernels.primitives.gaussian import OF_BOUNCE, bend_of_bounce, path_of

    @ti.kernel
    def bounced(
        mean: ti.types.ndarray(dtype=ti.f64, ndim=1),
        covariance: ti.types.ndarray(dtype=ti.f64, ndim=2),
        place: ti.types.ndarray(dtype=ti.f64, ndim=1),
        out: ti.types.ndarray(dtype=ti.f64, ndim=2),
    ):
        for _ in range(1):
            own = ti.Vector([place[0], place[1], place[2], 0.0, place[3]], dt=ti.f64)
            value, slope = path_of(mean, 5, own, 1, 0, 0)
            block = ti.Matrix.zero(ti.f64, 4, 4)
            for i in ti.static(range(4)):
                for j in ti.static(range(4)):
                    block[i, j] = covariance[i, j]
            more, spread = bend_of_bounce(slope, value[0], own, mean[5], mean[6], block)
            for i in ti.static(range(3)):
                out[0, i], out[4, i] = more[i], value[i]
                for j in ti.static(range(3)):
                    out[1 + i, j] = spread[i, j]
                for j in ti.static(range(4)):
                    out[5 + i, j] = slope[i, OF_BOUNCE[j]]

    return bounced


def over_line(at, place, bearing):
    """Length, departure and arrival (N, 3) over lines, of x, y, angle and offset (N, 4), by mirror images."""
    normal = np.stack([np.cos(at[:, 2]), np.sin(at[:, 2])], 1)

    def seen(point, whence):
        image = point + 2 * (at[:, 3] - (point * normal).sum(1))[:, None] * normal
        return image - whence

    to_anchor, to_agent = seen(place[None, :2], at[:, :2]), seen(at[:, :2], place[None, :2])
    length = np.hypot(np.hypot(*to_anchor.T), place[3])
    turned = (np.arctan2(to_agent[:, 1], to_agent[:, 0]), np.arctan2(to_anchor[:, 1], to_anchor[:, 0]))
    return np.stack([length, turned[0] - place[2], turned[1] - bearing], -1)


@given(SEEDS, st.booleans())
@settings(max_examples=40, deadline=None)
def test_what_derivatives_leave_out_of_a_bounce_equals_its_twin_and_is_what_samples_show(bounced, seed, high):
    draw = np.random.default_rng(seed)
    place = np.array([*draw.normal(size=2), draw.uniform(-3, 3), 0.2 * high])
    mean = np.array([*(place[:2] + draw.uniform(2, 6, 2)), 0.0, 0.0, 0.3, 0.0, 0.0])
    mean[5] = draw.uniform(-np.pi, np.pi)
    normal = np.array([np.cos(mean[5]), np.sin(mean[5])])
    mean[6] = max(normal @ place[:2], normal @ mean[:2]) + draw.uniform(0.1, 3)  # both on one side of it
    root = np.diag([0.05, 0.05, 0.06, 0.05]) @ (np.eye(4) + 0.3 * draw.normal(size=(4, 4)))
    covariance = root @ root.T
    found = np.zeros((8, 7))
    bounced(mean, covariance, place, found)
    whole = np.zeros((7, 7))
    whole[np.ix_([0, 1, 5, 6], [0, 1, 5, 6])] = covariance
    more, spread = reference.bend_of_bounce(mean, whole, np.array([5, 6]), place, place[3])
    np.testing.assert_allclose(found[0, :3], more, rtol=1e-4, atol=1e-9)
    np.testing.assert_allclose(found[1:4, :3], spread, rtol=1e-4, atol=1e-12)

    moved = (root @ draw.standard_normal((4, 40_000))).T
    centre = mean[[0, 1, 5, 6]]
    change = over_line(centre + moved, place, mean[4]) - over_line(centre[None], place, mean[4])
    change[:, 1:] = wrap(change[:, 1:])
    rest = change - moved @ found[5:8, :4].T
    scale = np.sqrt(np.diag(spread))
    np.testing.assert_allclose(rest.mean(0) / scale, more / scale, atol=0.15)
    assert rest.std(0) / scale == pytest.approx(np.ones(3), abs=0.2)


def test_a_line_close_to_its_anchor_bends_as_worked_out_by_hand(bounced):
    """The anchor at the origin, a line 0.5 m behind it: turned by a, its image goes round a circle of 1 m."""
    mean, covariance = np.array([-4.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.5]), np.zeros((4, 4))
    covariance[2, 2] = 0.2**2
    found = np.zeros((8, 7))
    bounced(mean, covariance, np.zeros(4), found)
    along = 4.0 / 5.0  # of 5 m, the image's circle of 1 m seen from the agent: -a^2 / 2 + a^2 / (2 * 5)
    assert found[0, 0] == pytest.approx(-0.5 * along * 0.2**2, rel=1e-6)
    assert found[1, 0] == pytest.approx(0.5 * (along * 0.2**2) ** 2, rel=1e-6)
    assert not found[0, 1:3].any()


@pytest.mark.parametrize("gap", [0.0, 0.02, 0.2])
def test_beside_the_image_of_its_anchor_a_bounce_bends_no_more_than_its_spread_allows(bounced, gap):
    """Nearer than the spread the series says nothing; at the very place no derivative has a direction."""
    mean, covariance = np.array([1.0 - gap, 0.0, 0.0, 0.0, 0.3, 0.0, 0.5]), 0.01 * np.eye(4)
    found, whole = np.full((8, 7), np.nan), np.zeros((7, 7))
    whole[np.ix_([0, 1, 5, 6], [0, 1, 5, 6])] = covariance
    bounced(mean, covariance, np.zeros(4), found)
    more, spread = reference.bend_of_bounce(mean, whole, np.array([5, 6]), np.zeros(4), 0.0)
    np.testing.assert_allclose(found[0, :3], more, rtol=1e-4, atol=1e-9)
    np.testing.assert_allclose(found[1:4, :3], spread, rtol=1e-4, atol=1e-12)
    assert np.isfinite(found[:4, :3]).all()
