"""Where one scan says that the agent may be, without any map."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import norm

import gridslam as gs
from gridslam.inference.beliefs.belief import Belief
from gridslam.inference.management.poses.pose_fix import Sources
from gridslam.inference.management.poses.pose_score import (
    IN_SIGHT,
    NEAREST_M,
    TWICE,
    AnchorTerms,
    PoseLikelihood,
)
from gridslam.inference.management.poses.pose_search import (
    APART_M,
    APART_RAD,
    PORTION,
    best_apart,
    find_modes,
    line_of_sight_poses,
    reflected_poses,
)
from gridslam.inference.management.poses.scan_terms import ScanTerms
from gridslam.inference.scans.anchor_measurements import split_by_anchor
from gridslam.world.geometry import course, line_between, mirror, unit, wrap
from gridslam.world.radio import REFLECTION_BINS


@pytest.fixture(scope="module")
def scene():
    return gs.Scene.load("room")


@pytest.fixture(scope="module")
def first_scans(scene):
    return list(gs.simulate(scene, "agent1", seed=4))[:4]


def pose_likelihood(scan, model):
    scans = split_by_anchor(scan, model)
    return PoseLikelihood.of(scans, [model.radio] * len(scans), model), scans


def slowly(pose, anchor_scan, model):
    """The score of one pose and one anchor, path by path, by the geometry of drawn paths."""
    radio, place = model.radio, anchor_scan.position
    distance = np.linalg.norm(pose[:2] - place)
    away = np.arctan2(*(pose[:2] - place)[::-1])
    strength = radio.amplitude(distance)
    log = -IN_SIGHT * float(radio.detection_probability(strength))
    for value, amplitude in zip(anchor_scan.value, anchor_scan.amplitude, strict=True):
        std = np.array([
            radio.distance_std(amplitude),
            radio.angle_std(amplitude, value[1], radio.anchor_aperture[anchor_scan.anchor]),
            radio.angle_std(amplitude, value[2], radio.agent_aperture),
        ])  # fmt: skip
        told = np.isfinite(value)
        straight = np.array([distance, away - anchor_scan.orientation, away + np.pi - pose[2]])
        gap = value - straight
        gap[1:] = wrap(gap[1:])
        fits = np.prod(norm.pdf(gap[told], scale=std[told]))
        seen = IN_SIGHT * fits * np.exp(radio.log_rician(amplitude, strength))
        near, far, bearing = pose[:2], place, pose[2] + value[2]
        if not told[2]:  # the same path from its other end
            near, far, bearing = place, pose[:2], anchor_scan.orientation + value[1]
        image = near + value[0] * unit(bearing)
        line = line_between(far, image)
        path = course(pose[None, :2], place[None], line[None], line[None], np.array([1]))
        born = 0.0
        if path.valid[0]:
            off, fits = wrap(value[1] - (path.departure[0] - anchor_scan.orientation)), 1.0
            if told.all():
                fits = (1 - TWICE) * norm.pdf(off, scale=np.hypot(*std[1:])) + TWICE / (2 * np.pi)
            level = radio.amplitude(value[0], REFLECTION_BINS)
            rice = np.exp(radio.log_rician(amplitude, level)).mean()
            born = model.birth_rate * value[0] * rice * fits / max(np.linalg.norm(image - far), NEAREST_M)
        clutter = radio.false_alarms * np.exp(radio.log_clutter(amplitude))
        clutter *= (2 * np.pi) ** (~told).sum()  # of what was measured alone
        log += np.log1p((seen + born) / clutter)
    return float(log)


@pytest.mark.slow
@given(st.integers(0, 2**32 - 1), st.booleans())
@settings(max_examples=30, deadline=None)
def test_scores_equal_those_worked_out_path_by_path(scene, first_scans, seed, arrives):
    draw, model, scan = np.random.default_rng(seed), scene.filter_model("agent1"), first_scans[seed % 4]
    if not arrives:
        scan = replace(scan, aoa_rad=np.full(len(scan), np.nan))
    likelihood, scans = pose_likelihood(scan, model)
    assert likelihood.tells_heading is arrives
    track = scene.track("agent1")
    near = np.array([*track.position_m[0], track.heading_rad[0]]) + draw.normal(0, [0.1, 0.1, 0.05])
    poses = np.stack([near, draw.uniform([-4, -3, -3], [4, 3, 3])])
    found = likelihood.score(poses)
    for pose, score in zip(poses, found, strict=True):
        # p_d comes from a table there
        assert score == pytest.approx(sum(slowly(pose, own, model) for own in scans), abs=2e-3)


def test_a_departure_tells_of_a_line_only_where_nothing_arrives(scene, first_scans):
    """A scan of which some paths arrive is placed by these: the others' lines would fit anywhere."""
    model, scan = scene.filter_model("agent1"), first_scans[0]
    deaf = replace(scan, aoa_rad=np.full(len(scan), np.nan))
    mixed = replace(scan, aoa_rad=np.where(np.arange(len(scan)) == 0, scan.aoa_rad, np.nan))
    born = [
        sum(int(np.isfinite(terms.log_born).sum()) for terms in pose_likelihood(one, model)[0].terms)
        for one in (scan, deaf, mixed)
    ]
    assert born == [len(scan), len(scan), 1]


def test_places_are_proposed_by_lines_of_sight_and_walls_without_arrivals(scene, first_scans):
    """Few uniform poses find none: a line of sight, or a known wall, says where the agent is."""
    model, track = scene.filter_model("agent1"), scene.track("agent1")
    deaf = replace(first_scans[0], aoa_rad=np.full(len(first_scans[0]), np.nan))
    likelihood, scans = pose_likelihood(deaf, model)
    modes = find_modes(likelihood, whole_room(model), model.grid, 60, [1, 2], poses=20)
    assert np.hypot(*(modes.pose[:, :2] - track.position_m[0]).T).min() < 0.3
    wall = np.array([0.5 * np.pi, 3.0])
    image = mirror(wall, scans[0].position)
    terms = replace(likelihood.terms[0], known=Sources(image[None], wall[None], np.ones(1), np.ones(1)))
    none, told = (reflected_poses(terms, np.random.default_rng(1), facing=f) for f in (None, 0.4))
    assert not len(none)
    np.testing.assert_allclose(told[:, 2], 0.4)
    assert np.hypot(*(told[:, :2] - track.position_m[0]).T).min() < 0.3


def test_poses_of_lines_of_sight_hear_what_was_heard(scene, first_scans):
    model = scene.filter_model("agent1")
    likelihood, scans = pose_likelihood(first_scans[0], model)
    for terms, own in zip(likelihood.terms, scans, strict=True):
        poses = line_of_sight_poses(terms, np.random.default_rng(1))
        first = poses[:: len(poses) // len(own)]
        away = first[:, :2] - own.position
        np.testing.assert_allclose(np.linalg.norm(away, axis=1), own.value[:, 0])
        bearing = np.arctan2(away[:, 1], away[:, 0])
        np.testing.assert_allclose(wrap(bearing - own.orientation - own.value[:, 1]), 0, atol=1e-9)
        np.testing.assert_allclose(wrap(bearing + np.pi - first[:, 2] - own.value[:, 2]), 0, atol=1e-9)


def whole_room(model):
    """A belief that knows nothing but the region."""
    return Belief(model.start_mean, np.diag([21.0, 21.0, 1e-3, 1e-3, 3.3]))


@pytest.mark.parametrize("most", [5, 40, 10_000])
def test_the_best_of_each_neighbourhood_are_those_of_one_pose_after_the_other(most):
    draw = np.random.default_rng(7)
    poses = draw.uniform([0, 0, -np.pi], [1.5, 1.5, np.pi], (4 * PORTION, 3))
    log = np.round(draw.normal(size=len(poses)), 2)  # some are alike: the first is taken
    slow, more = list[int](), False
    for one in sorted(range(len(log)), key=lambda n: -log[n]):
        gap = np.abs(poses[slow] - poses[one])
        turn = np.minimum(gap[:, 2], 2 * np.pi - gap[:, 2])
        near = (np.hypot(gap[:, 0], gap[:, 1]) < APART_M) & (turn < APART_RAD)
        if log[one] > log.max() - 6 and not near.any():
            more = len(slow) == most
            if more:
                break
            slow.append(one)
    assert best_apart(poses, log, 6.0, most) == (slow, more)
    assert len(slow) > 4


@pytest.mark.slow
@pytest.mark.parametrize(
    "measures",
    [
        ("distance", "aod", "aoa", "amplitude"),
        ("distance", "aoa", "amplitude"),
        ("distance", "aod", "amplitude"),
    ],
)
def test_the_true_pose_is_listed_of_a_start_that_is_known_to_nothing(scene, measures):
    radio = scene.radio.model_copy(update={"measures": measures})
    scene = scene.model_copy(update={"radio": radio})
    model, track = scene.filter_model("agent1"), scene.track("agent1")
    scan = list(gs.simulate(scene, "agent1", seed=4))[2]
    likelihood, _ = pose_likelihood(scan, model)
    modes = find_modes(likelihood, whole_room(model), model.grid, 60, [1, 2], poses=40_000)
    assert modes.complete
    gap = modes.pose - np.array([*track.position_m[2], track.heading_rad[2]])
    gap[:, 2] = wrap(gap[:, 2])
    far = np.einsum("ki,ij,kj->k", gap, np.diag([1, 1, 1]), gap)
    right = int(far.argmin())
    assert modes.score[right] > modes.score[0] - 8
    assert gap[right] @ np.linalg.solve(modes.covariance[right], gap[right]) < 16
    if "aoa" not in measures:
        np.testing.assert_array_equal(modes.pose[:, 2], model.start_mean[4])
        np.testing.assert_allclose(modes.covariance[:, 2], [[0, 0, 3.3]] * len(modes))
    assert (modes.log_prior < 0).all(), "a mode has less than all of the prior"
    assert (np.diff(modes.score) <= 0).all()


def test_a_scan_that_tells_nothing_has_no_complete_list(scene, first_scans):
    model = scene.filter_model("agent1")
    scan = first_scans[0]
    quiet = np.argsort(scan.amplitude)[:1]
    names = ("anchor", "distance_m", "aod_rad", "aoa_rad", "amplitude")
    faint = replace(scan, **{name: getattr(scan, name)[quiet] for name in names})
    likelihood, _ = pose_likelihood(faint, model)
    modes = find_modes(likelihood, whole_room(model), model.grid, 10, [1], poses=4000)
    assert not modes.complete
    assert len(modes) <= 10


class MadeUp:
    """Scores of a place that fits, the slope about it, and islands: with doubled deviations, and true."""

    terms, tells_heading = (), True

    def __init__(self, place, islands):
        self.place, self.islands = place, islands

    def score(self, poses, widen=1.0):
        def apart(centre):
            return np.hypot(poses[:, 0] - centre[0], poses[:, 1] - centre[1])

        off = apart(self.place)
        score = np.where(off < 0.2, 50.0, np.where(off < 1.2, 30.0 - off, 0.0))
        for centre, blurred, true in self.islands:
            score = np.where(apart(centre) < 0.15, blurred if widen > 1 else true, score)
        return score


@pytest.mark.parametrize("last_fits", [False, True])
def test_a_list_is_complete_once_its_last_candidates_lead_to_no_new_place(scene, last_fits):
    """More candidates than are looked at; the last of them ends where the first did, or at its own place."""
    model, islands = scene.filter_model("agent1"), [((x, -2), 45, 0) for x in range(-3, 3)]
    likelihood = MadeUp((1, 1), [*islands, ((3, -2), 40, 44)] if last_fits else islands)
    belief = replace(whole_room(model), covariance=np.diag([21.0, 21.0, 1e-3, 1e-3, 1e-6]))
    modes = find_modes(likelihood, belief, model.grid, 4, [1], poses=20_000)
    assert modes.complete is not last_fits
    np.testing.assert_array_equal(modes.score, [50, 44] if last_fits else [50])
    np.testing.assert_allclose(modes.pose[0, :2], 1, atol=0.1)


def test_the_order_of_measurements_and_what_is_not_heard_change_no_score(scene, first_scans):
    model = scene.filter_model("agent1")
    scan, draw = first_scans[1], np.random.default_rng(3)
    order = draw.permutation(len(scan))
    names = ("anchor", "distance_m", "aod_rad", "aoa_rad", "amplitude")
    mixed = replace(scan, **{name: getattr(scan, name)[order] for name in names})
    poses = draw.uniform([-4, -3, -3], [4, 3, 3], (50, 3))
    here, there = (pose_likelihood(one, model)[0].score(poses) for one in (scan, mixed))
    np.testing.assert_allclose(here, there, atol=1e-9)
    silent = replace(scan, **{name: getattr(scan, name)[:0] for name in names})
    assert (pose_likelihood(silent, model)[0].score(poses) < 0).all(), "lines of sight that nobody heard"


@pytest.mark.parametrize("name", ["aod_rad", "aoa_rad", "amplitude", "distance_m"])
def test_what_was_not_measured_scores_finitely(scene, first_scans, name):
    model, scan = scene.filter_model("agent1"), first_scans[0]
    column = getattr(scan, name).copy()
    column[::2] = np.nan
    likelihood, _ = pose_likelihood(replace(scan, **{name: column}), model)
    poses = np.random.default_rng(5).uniform([-4, -3, -3], [4, 3, 3], (50, 3))
    assert np.isfinite(likelihood.score(poses)).all()


def of_map(place, chance=0.8):
    """Sources of an anchor's line of sight and of single bounces over two walls of the room."""
    line = np.array([[0.0, 0.0], [np.pi / 2, 3.0], [0.0, -4.0]])
    image = np.stack([place, mirror(line[1], place), mirror(line[2], place)])
    return Sources(image, line, np.array([1.0, 0.7, 0.6]), np.array([0.9, chance, 0.5]))


def test_scores_with_a_map_add_what_its_surfaces_explain(scene, first_scans):
    model, track = scene.filter_model("agent1"), scene.track("agent1")
    own = split_by_anchor(first_scans[1], model)[0]
    radio, over = model.radio, of_map(own.position)
    with_map, without = (PoseLikelihood.of([own], [radio], model, known).terms[0] for known in ([over], None))
    poses = np.stack([[*track.position_m[1], track.heading_rad[1]], [1.0, -1.0, 0.5], [3.9, 3.9, 2.0]])
    found, plain = with_map.score(poses, 1.0), without.score(poses, 1.0)
    assert found[0] > plain[0] + 5, "two walls explain their bounces"
    for pose, score, alone in zip(poses, found, plain, strict=True):
        missed, ratio = 0.0, np.zeros(len(own))
        for image, line, level, chance in list(
            zip(over.image, over.line, over.level, over.chance, strict=True)
        )[1:]:
            path = course(pose[None, :2], own.position[None], line[None], line[None], np.array([1]))
            if not path.valid[0]:
                continue
            strength = radio.amplitude(np.linalg.norm(image - pose[:2]), level)
            missed += chance * float(radio.detection_probability(strength))
            for m, (value, amplitude) in enumerate(zip(own.value, own.amplitude, strict=True)):
                std = np.array([
                    radio.distance_std(amplitude),
                    radio.angle_std(amplitude, value[1], radio.anchor_aperture[0]),
                    radio.angle_std(amplitude, value[2], radio.agent_aperture),
                ])  # fmt: skip
                std = np.hypot(std, [0.03, 0.02, 0.02])
                gap = value - [
                    path.distance[0],
                    path.departure[0] - own.orientation,
                    path.arrival[0] - pose[2],
                ]
                gap[1:] = wrap(gap[1:])
                density = np.prod(norm.pdf(gap, scale=std)) * np.exp(radio.log_rician(amplitude, strength))
                ratio[m] += chance * density / (radio.false_alarms * np.exp(radio.log_clutter(amplitude)))
        base = np.array([
            PoseLikelihood.of([replace_rows(own, m)], [radio], model).terms[0].score(pose[None], 1.0)[0]
            for m in range(len(own))
        ])  # fmt: skip
        sight = (
            PoseLikelihood.of([replace_rows(own, None)], [radio], model).terms[0].score(pose[None], 1.0)[0]
        )
        wanted = sight - missed + np.log(np.exp(base - sight) + ratio).sum()
        assert alone == pytest.approx(base.sum() - (len(own) - 1) * sight, abs=1e-6)
        assert score == pytest.approx(wanted, abs=0.01)


def replace_rows(own, row):
    """An anchor's scan with one of its measurements, or none."""
    rows = slice(0, 0) if row is None else slice(row, row + 1)
    names = ("value", "own_std", "amplitude", "table")
    return replace(own, **{name: getattr(own, name)[rows] for name in names})


def test_poses_by_a_map_hear_single_bounces_as_they_were_heard(scene, first_scans):
    model = scene.filter_model("agent1")
    own = split_by_anchor(first_scans[1], model)[0]
    terms = PoseLikelihood.of([own], [model.radio], model, [of_map(own.position)]).terms[0]
    poses = reflected_poses(terms, np.random.default_rng(1), copies=1)
    assert len(poses) == 2 * len(own)
    line = of_map(own.position).line[1]
    for pose, value in zip(poses[: len(own)], own.value, strict=True):
        path = course(pose[None, :2], own.position[None], line[None], line[None], np.array([1]))
        if path.valid[0]:
            there = [path.distance[0], path.departure[0] - own.orientation, path.arrival[0] - pose[2]]
            np.testing.assert_allclose(there[0], value[0], atol=1e-9)
            np.testing.assert_allclose(wrap(np.array(there[1:]) - value[1:]), 0, atol=1e-9)


def test_clutter_of_what_was_measured_does_not_depend_on_where_distances_may_lie(scene, first_scans):
    """A row without a distance has the same clutter in twice the window; one with it half as dense."""
    model, scan = scene.filter_model("agent1"), first_scans[0]
    scan = replace(scan, distance_m=np.where(np.arange(len(scan)) == 0, np.nan, scan.distance_m))
    own = split_by_anchor(scan, model)[0]
    most = model.radio.max_distance_m
    narrow, wide = (
        AnchorTerms.of(own, replace(model.radio, window_m=window), 0.1).log_clutter
        for window in (None, (-most, most))
    )
    blind = np.isnan(own.value[:, 0])
    assert blind.sum() == 1
    np.testing.assert_allclose(wide - narrow, np.where(blind, 0.0, -np.log(2)), atol=1e-12)
    terms = [ScanTerms.of(own, replace(model.radio, window_m=one)).flat for one in (None, (-most, most))]
    np.testing.assert_allclose(terms[1] / terms[0], [2, 1, 1])
