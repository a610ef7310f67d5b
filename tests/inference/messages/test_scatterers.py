"""Walls and points that scatter, told apart by what is heard of them along the way."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scene_samples import short

import gridslam as gs
from gridslam.inference.beliefs.belief import Belief
from gridslam.inference.management import readout
from gridslam.inference.management.merging import _united
from gridslam.inference.messages.mirrors import unweighed_bank
from gridslam.inference.messages.scatterers import BESIDE, ODDS, WALLS, fitted, on_time, wall_chances
from gridslam.inference.state.surface_bank import FORMS, SurfaceBank
from gridslam.kernels import DECIDED, UNMEASURED
from gridslam.reference.scatterers import FADING, MOST_TOLD, POINT, WALL, off_point, off_wall
from gridslam.world.geometry import trace, unit, wrap

ANCHOR = np.array([0.5, -0.4, 0.3])
EXACT = np.zeros((3, 3))
STD = np.array([0.02, 0.08, 0.08])
COORDINATE = st.floats(-6.0, 6.0)


def along_the_way(steps=30):
    """Poses (N, 3) on a bent way past what is to be told."""
    turn = np.linspace(0.0, 1.2, steps)
    return np.stack([3 + 2 * np.sin(turn), 1 - 2 * np.cos(turn), turn], 1)


def off_a_wall(line, pose):
    path = trace(pose[None, :2], ANCHOR[None, :2], line[None], line[None], np.array([1]))
    return np.array([path.distance[0], path.departure[0] - ANCHOR[2], path.arrival[0] - pose[2]])


def off_a_point(point, pose):
    going, coming = point - ANCHOR[:2], point - pose[:2]
    directions = [np.arctan2(*going[::-1]) - ANCHOR[2], np.arctan2(*coming[::-1]) - pose[2]]
    return np.array([np.hypot(*going) + np.hypot(*coming), *directions])


def told(heard_of, thing, seed=0, missing=None, poses=None):
    """Forms (11,) of what was heard of a wall or point from all poses, with noise."""
    draw, forms = np.random.default_rng(seed), np.zeros((1, FORMS))
    poses = along_the_way() if poses is None else poses
    variance = STD[None] ** 2
    if missing is not None:
        variance = variance.copy()
        variance[0, missing] = UNMEASURED
    for pose in poses:
        value = heard_of(thing, pose) + STD * draw.standard_normal(3)
        image = pose[:2] + value[0] * unit(value[2] + pose[2])
        step = image - ANCHOR[:2]  # what a filter would take for a wall now
        angle, middle = np.arctan2(step[1], step[0]), 0.5 * (image + ANCHOR[:2])
        pivot = unit(angle + 0.5 * np.pi) @ middle  # known to 6 degrees about there, and to 0.2 m
        spread = [0.01, 0.01 * pivot, 0.01 * pivot**2 + 0.04]
        line = np.array([angle, unit(angle) @ middle, *spread])
        forms = fitted(forms, np.hstack([value[None], variance]), ANCHOR[None], pose, EXACT, line[None])
    return forms[0]


@given(angle=st.floats(-3.0, 3.0), offset=COORDINATE, x=COORDINATE, y=COORDINATE, heading=COORDINATE)
@settings(max_examples=60, deadline=None)
def test_what_is_heard_off_a_wall_is_as_its_path_is_drawn(angle, offset, x, y, heading):
    line, pose = np.array([angle, offset]), np.array([x, y, heading])
    sides = offset - unit(angle) @ np.stack([pose[:2], ANCHOR[:2]]).T
    assume(np.prod(sides) > 0 and np.abs(sides).min() > 0.1)
    value, slope, _ = off_wall(line[None], ANCHOR[None], pose)
    drawn = off_a_wall(line, pose)
    assert value[0, 0] == pytest.approx(drawn[0])
    np.testing.assert_allclose(wrap(value[0, 1:] - drawn[1:]), 0, atol=1e-9)
    assert_slopes(slope[0], lambda at: off_wall(at[None], ANCHOR[None], pose)[0][0], line)


@given(point=st.tuples(COORDINATE, COORDINATE), x=COORDINATE, y=COORDINATE, heading=COORDINATE)
@settings(max_examples=60, deadline=None)
def test_what_is_heard_of_a_point_by_hand(point, x, y, heading):
    point, pose = np.array(point), np.array([x, y, heading])
    assume(np.hypot(*(point - pose[:2])) > 0.1 and np.hypot(*(point - ANCHOR[:2])) > 0.1)
    value, slope, _ = off_point(point[None], ANCHOR[None], pose)
    expected = off_a_point(point, pose)
    assert value[0, 0] == pytest.approx(expected[0])
    np.testing.assert_allclose(wrap(value[0, 1:] - expected[1:]), 0, atol=1e-9)
    assert_slopes(slope[0], lambda at: off_point(at[None], ANCHOR[None], pose)[0][0], point)


def assert_slopes(slope, value_at, at):
    for entry in range(2):
        step = 1e-6 * np.eye(2)[entry]
        change = value_at(at + step) - value_at(at - step)
        change[1:] = wrap(change[1:])
        np.testing.assert_allclose(slope[:, entry], change / 2e-6, rtol=1e-4, atol=1e-5)


def test_lengths_bend_as_their_circles_do():
    """Off a wall about the agent as those of one circle; of a point of one about each end."""
    pose = np.array([3.0, -0.4, 0.0])
    value, _, bend = off_wall(np.array([[np.pi / 2, 1.6]]), ANCHOR[None], pose)  # the image is at (0.5, 3.6)
    assert bend[0, 1].tolist() == [0.0, 0.0]
    assert value[0, 0] == pytest.approx(np.hypot(2.5, 4.0))
    # an offset moves the image by (0, 2): across the way by 2 x 2.5 / length
    assert bend[0, 0, 1] ** 2 == pytest.approx((2 * 2.5 / value[0, 0]) ** 2 / value[0, 0])
    _, _, bend = off_point(np.array([[0.5, 1.6]]), ANCHOR[None], np.array([0.5, -2.4, 0.0]))
    np.testing.assert_allclose(np.square(bend[0]), [[1 / 2.0, 0.0], [1 / 4.0, 0.0]], atol=1e-12)


@pytest.mark.parametrize("missing", [None, 1, 2], ids=["both angles", "no AoD", "no AoA"])
def test_walls_and_points_are_told_apart_and_placed(missing):
    """Twenty seeds each; squared errors of what is placed, over their variances, are those of two numbers."""
    wall, point, squares = np.array([1.2, 4.0]), np.array([1.5, 3.2]), []
    for seed in range(20):
        forms = told(off_a_wall, wall, seed, missing)
        assert forms[ODDS] > (5 if missing is None else 0)
        forms = told(off_a_point, point, seed, missing)
        assert forms[ODDS] < (-5 if missing is None else 0)
        gap, (xx, xy, yy) = forms[POINT][:2] - point, forms[POINT][2:]
        squares.append(gap @ np.linalg.solve([[xx, xy], [xy, yy]], gap))
        assert np.hypot(*gap) < 0.2
    assert (
        0.7 < np.mean(squares) < (4.5 if missing is None else 9.0)
    )  # one angle bends more than half a square


def test_a_wall_that_is_fitted_is_the_wall():
    gaps = []
    for seed in range(20):
        forms = told(off_a_wall, np.array([1.2, 4.0]), seed)
        (xx, xy, yy), gap = forms[WALL][2:], forms[WALL][:2] - [1.2, 4.0]
        gaps.append(gap @ np.linalg.solve([[xx, xy], [xy, yy]], gap))
    assert 0.7 < np.mean(gaps) < 4.5


def test_one_measurement_tells_nothing_yet_and_none_tells_much():
    forms = told(off_a_point, np.array([1.5, 3.2]), poses=along_the_way()[:1])
    assert forms[ODDS] == 0
    assert forms[[2, 4, 7, 9]].all()
    again = told(off_a_point, np.array([1.5, 3.2]), poses=along_the_way()[[0, 29]])
    assert abs(again[ODDS]) <= MOST_TOLD
    # nothing moves where nothing is measured
    blind = fitted(
        forms[None], np.array([[0.0] * 3 + [UNMEASURED] * 3]), ANCHOR[None], np.zeros(3), EXACT,
        np.zeros((1, 5)),
    )  # fmt: skip
    grown = np.where(np.isin(np.arange(FORMS), [2, 3, 4, 7, 8, 9]), FADING, 1.0)
    np.testing.assert_allclose(blind[0], grown * forms)


def bank_of(*rows):
    """A bank with such forms: odds, and a point (x, y) known to so much."""
    bank = SurfaceBank.empty(1)
    for number in range(len(rows)):
        bank = bank.add(number, 1.0, np.full(20, 0.05), 0.0, (0, -1, -1))
    forms = np.zeros((len(rows), FORMS))
    for form, (odds, x, y, std) in zip(forms, rows, strict=True):
        form[5:10], form[ODDS] = [x, y, 0.5 * std**2, 0, 0.5 * std**2], odds
    return replace(bank, forms=forms)


def test_chances_by_hand():
    def sigmoid(x):
        return 1 / (1 + np.exp(-x))

    known, young, elsewhere = (-12.0, 1.0, 1.0, 0.05), (-0.5, 1.2, 1.0, 0.2), (-0.5, 3.0, 1.0, 0.2)
    bank = bank_of(known, young, elsewhere, (0.0, 0.0, 0.0, 0.0))
    expected = [sigmoid(-12 + BESIDE), sigmoid(-0.5 + BESIDE), sigmoid(-0.5 + WALLS), 1.0]
    np.testing.assert_allclose(wall_chances(bank), expected)
    vague = bank_of((-12.0, 1.0, 1.0, 0.2), young)  # a point that isn't sharp names no others
    np.testing.assert_allclose(wall_chances(vague), [sigmoid(-12 + WALLS), sigmoid(-0.5 + WALLS)])


SPREADS = (np.s_[2:5], np.s_[7:10])


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=60, deadline=None)
def test_odds_are_those_of_two_filters_one_quantity_after_the_other(seed):
    """By joint updates of both forms, whose measurements' errors are apart: log N(z; h, H S H' + R)."""
    draw, point = np.random.default_rng(seed), np.array([1.5, 3.2])
    forms = told(off_a_point, point, seed, poses=along_the_way()[: draw.integers(2, 12)])
    pose = along_the_way()[draw.integers(12, 30)]
    value = off_a_point(point, pose) + 0.5 * STD * draw.standard_normal(3) + [0, 2 * np.pi, -2 * np.pi]
    known = np.diag([0.01, 0.01, 0.002]) * draw.choice([0.0, 1.0])
    after = fitted(forms[None], np.array([[*value, *STD**2]]), ANCHOR[None], pose, known, np.zeros((1, 5)))[0]
    logs = []
    for heard_of, place, spread in zip((off_wall, off_point), (WALL, POINT), SPREADS, strict=True):
        mean, (xx, xy, yy) = forms[place][:2], forms[spread]
        predicted, slope, bend = (part[0] for part in heard_of(mean[None], ANCHOR[None], pose))
        covariance = np.array([[xx, xy], [xy, yy]])
        noise = np.diag(STD**2 + np.array([0.5 * np.einsum("ki,ij,kj", bend, covariance, bend) ** 2, 0, 0]))
        noise += np.diag(known[0, 0] * np.array([1, 1 / predicted[0] ** 2, 1 / predicted[0] ** 2]))
        noise[2, 2] += known[2, 2]
        gap = value - predicted
        gap[1:] = wrap(gap[1:])
        whole = slope @ covariance @ slope.T + noise
        gain = covariance @ slope.T @ np.linalg.inv(whole)
        logs.append(-0.5 * gap @ np.linalg.solve(whole, gap) - 0.5 * np.linalg.slogdet(whole)[1])
        if (np.abs(gap) < 2 * np.sqrt(np.diag(whole))).all():  # nothing is cut
            np.testing.assert_allclose(after[place][:2], mean + gain @ gap, atol=1e-8)
            left = FADING * (covariance - gain @ slope @ covariance)
            np.testing.assert_allclose(after[spread], left[[0, 0, 1], [0, 1, 1]], rtol=1e-5, atol=1e-10)
    change = np.clip(logs[0] - logs[1], -MOST_TOLD, MOST_TOLD)
    assert after[ODDS] == pytest.approx(max(forms[ODDS] + change, -DECIDED), abs=1e-4)


def heard_by(slam, scene, steps):
    """The bank after some steps."""
    for scan in list(gs.simulate(scene, "agent1", 2))[:steps]:
        slam.step(scan)
    return slam.state.surfaces


@pytest.mark.parametrize("method", [gs.GridSlam, gs.AdaptiveSlam])
def test_walls_are_fitted_where_the_belief_has_them(method):
    """Each by what its own anchors hear; a decided wall isn't looked at any more."""
    scene = short("room", 25, 256)
    slam = method(scene, seed=2)
    bank, lines = heard_by(slam, scene, 25), slam.state.belief.lines
    known = (bank.existence > 0.9) & (bank.forms[:, ODDS] > 5)
    assert known.sum() >= 4
    gap = bank.forms[known, :2] - lines[known]
    assert np.abs(wrap(gap[:, 0])).max() < 0.1
    assert np.abs(gap[:, 1]).max() < 0.2
    assert (bank.forms[known, ODDS] < DECIDED + MOST_TOLD).all()


def test_nothing_is_fitted_of_images_of_one_anchor_or_with_heights_or_while_lost():
    scene = short("room", 6, 256)
    assert not heard_by(gs.VirtualAnchorSlam(scene, seed=2), scene, 6).forms.any()
    level = gs.Scene.load("ceiling")
    assert not heard_by(gs.GridSlam(level, seed=2), level, 6).forms.any()
    slam = gs.GridSlam(scene, seed=2)
    assert heard_by(slam, scene, 6).forms.any()
    assert not unweighed_bank(slam.state.surfaces).forms.any()


def test_a_merged_surface_keeps_the_older_form():
    forms = np.zeros((2, FORMS))
    forms[1] = np.arange(FORMS) + 1.0
    bank = replace(bank_of((0.0, 0, 0, 0.0), (0.0, 0, 0, 0.0)), forms=forms)
    assert _united(bank, 0, 1).forms[0].tolist() == forms[1].tolist()  # of which there was none
    other = replace(bank, forms=np.array([forms[1], forms[1] + 2.0]))
    assert _united(other, 0, 1).forms[0].tolist() == forms[1].tolist()


def test_estimates_show_what_is_rather_a_point_as_hardly_there(monkeypatch):
    scene = short("room", 4, 256)
    slam = gs.GridSlam(scene, seed=2)
    monkeypatch.setattr(readout, "wall_chances", lambda bank: np.full(len(bank), 0.25))
    for scan in gs.simulate(scene, "agent1", 2):
        estimate = slam.step(scan)
    assert len(estimate.surfaces)
    assert (estimate.surfaces.existence <= 0.25).all()
    assert (slam.state.surfaces.existence > 0.9).any()


ROOM = """
[radio]
snr_at_1m_db = 36.0
[grid]
x_m = [-4.8, 4.8]
y_m = [-3.8, 3.8]
[materials]
concrete = 0.7
[[anchors]]
name = "A"
position_m = [-3.1, 2.2]
[[anchors]]
name = "B"
position_m = [2.9, -2.3]
[[walls]]
material = "concrete"
points_m = [[-4.0, -3.0], [4.0, -3.0], [4.0, 3.0], [-4.0, 3.0]]
closed = true
[[scatterers]]
position_m = [0.4, 0.3]
size_m = 0.4
[[scatterers]]
position_m = [-2.9, -1.0]
size_m = 0.4
[[agents]]
name = "agent1"
start_m = [-2.0, -1.6]
waypoints_m = [[0.9, -1.6], [2.2, 0.3], [0.5, 1.9], [-1.6, 1.2]]
steps = 110
[filter]
particles = 512
"""


@pytest.mark.slow
@pytest.mark.parametrize(("method", "seed"), [("grid", 0), ("adaptive", 1)])
def test_posts_in_a_room_are_no_walls(method, seed):
    """5 (grid) and 7 false walls before, of these seeds, as either anchor hears either post."""
    scene = gs.Scene.from_toml(ROOM, "posts")
    run = gs.map_scene(scene, gs.simulate(scene, "agent1", seed), method=method, seed=seed)
    score = run.score(gs.ground_truth(scene, "agent1"))
    assert score["surfaces_matched"] == 4
    assert score["surfaces_false"] <= 3


def test_clocks_are_taken_off_distances_each_anchor_s_own():
    """Of three anchors, 4 m early, known, and 7 m late; the distance of the second surface is the third's."""
    covariance = np.diag([0.1] * 5 + [0.2, 0.3, 0.5] + [0.1] * 2)
    belief = Belief(np.array([1.0] * 5 + [-4.0, 0.0, 7.0] + [0.5, 2.0]), covariance, clocks=3)
    heard = np.array([[10.0, 1, 2, 0.01, 0.02, 0.03], [20.0, 3, 4, 0.04, 0.05, 0.06]])
    expected = [[14.0, 1, 2, 0.21, 0.02, 0.03], [13.0, 3, 4, 0.54, 0.05, 0.06]]
    np.testing.assert_allclose(on_time(heard, belief, np.array([0, 2])), expected)
    known = Belief(np.ones(7), np.eye(7))
    np.testing.assert_array_equal(on_time(heard, known, np.array([0, 2])), heard)


@pytest.mark.slow
@pytest.mark.parametrize(("method", "seed", "most"), [("network", 2, 3), ("network_grid", 1, 1)])
def test_nor_are_they_where_clocks_are_unknown(method, seed, most):
    """5 (network) and 3 false walls before, of these seeds."""
    prior = "[clocks]\nanchor_prior_ns = 100.0\nagent_prior_ns = 1.75\nwalk_ns = 0.05\n[materials]"
    text = ROOM.replace("[materials]", prior)
    for place, offset in (("[-3.1, 2.2]", 40.0), ("[2.9, -2.3]", -60.0)):
        text = text.replace(place, f"{place}\nclock = {{ offset_ns = {offset} }}")
    scene = gs.Scene.from_toml(text, "posts")
    heard = gs.simulate(scene, ["agent1"], seed, unlabelled=True)
    run = gs.map_network(scene, heard, method=method, seed=seed).runs["agent1"]
    score = run.score(gs.ground_truth(scene, "agent1"))
    assert score["surfaces_matched"] == 4
    assert score["surfaces_false"] <= most
