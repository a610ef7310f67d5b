"""Radios that are fainter than the scene says: lines of sight are found, and tell by how much."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scene_samples import short

import gridslam as gs
from gridslam.inference.management import unknown_gain
from gridslam.inference.management.unknown_gain import likeliest_gain
from gridslam.inference.scans.anchor_measurements import split_by_anchor

SCENE = short("room", 40, particles=256)


def told(louder_db, scene=SCENE):
    """The scene as a filter is told it, whose radio is so much louder than it is."""
    radio = scene.radio.model_copy(update={"snr_at_1m_db": scene.radio.snr_at_1m_db + louder_db})
    return scene.model_copy(update={"radio": radio})


@cache
def mapped(louder_db, seed):
    return gs.map_scene(told(louder_db), gs.simulate(SCENE, "agent1", seed), seed=seed, start="exact")


@pytest.mark.parametrize("fainter_db", [3.0, 9.0])
def test_a_fainter_radio_than_told_costs_nothing(fainter_db):
    """Lines of sight were taken for walls' images: of 15 drawn plans the error doubled, and two were lost."""
    right, run = mapped(0.0, 2), mapped(fainter_db, 2)
    off = [
        np.linalg.norm(one.trajectory.position_m - SCENE.track("agent1").position_m, axis=1)
        for one in (right, run)
    ]
    np.testing.assert_allclose(off[1][5:].mean(), off[0][5:].mean(), atol=0.005)
    scores = run.score(gs.ground_truth(SCENE, "agent1"))
    assert scores["surfaces_false"] <= 1
    assert scores["surfaces_matched"] >= right.score(gs.ground_truth(SCENE, "agent1"))["surfaces_matched"] - 1


def test_the_gain_is_told_at_the_first_step():
    heard = gs.simulate(SCENE, "agent1", 3)
    slam = gs.GridSlam(told(6.0), seed=3)
    slam.step(heard.scan(0))
    assert slam.state.calibration.gain == pytest.approx(0.5, rel=0.15)


def test_a_line_of_sight_that_was_half_believed_leaves_the_gain_open():
    """It was known to 0.05 then, and not used, since 0.79 wasn't beyond doubt, and never asked for again."""
    scene = short("alcove", 20, particles=256)
    slam = gs.GridSlam(told(3.0, scene), seed=5)
    for scan in gs.simulate(scene, "agent1", 5):
        slam.step(scan)
    assert slam.state.calibration.gain == pytest.approx(10 ** (-3 / 20), rel=0.05)


@pytest.mark.parametrize("share", [1e-3, 0.02])
def test_amplitudes_that_are_none_of_this_radios_end_nothing(share):
    """All below what noise alone makes: the gain was 0, and its logarithm an error at the first step."""
    brief = short("room", 10, particles=256)
    heard = gs.simulate(brief, "agent1", 1)
    run = gs.map_scene(brief, replace(heard, amplitude=share * heard.amplitude), seed=1, start="exact")
    assert len(run.estimates) == 10


@pytest.mark.parametrize("away_m", [0.0, 1e-12, 1e-9, 1e-4])
def test_an_agent_at_an_anchor_sees_it_in_no_direction(away_m):
    slam = gs.GridSlam(told(6.0), seed=1)
    x, y = SCENE.anchor_positions[0, :2]
    slam.start_at((x + away_m, y), 0.0)
    estimate = slam.step(gs.simulate(SCENE, "agent1", 1).scan(0))
    assert np.isfinite(estimate.position_m).all()


def test_of_a_radio_as_told_no_step_is_taken_again(monkeypatch):
    asked = []
    plain = unknown_gain.likeliest_gain
    monkeypatch.setattr(unknown_gain, "likeliest_gain", lambda *some: asked.append(plain(*some)) or asked[-1])
    slam = gs.GridSlam(SCENE, seed=1)
    for scan in gs.simulate(SCENE, "agent1", 1):
        slam.step(scan)
    assert asked == [], "the first line of sight tells the gain"


def test_a_gain_that_explains_less_is_not_believed(monkeypatch):
    monkeypatch.setattr(unknown_gain, "UNTOLD", 0.0)
    monkeypatch.setattr(unknown_gain, "likeliest_gain", lambda *_: (0.4, 0.01))
    slam = gs.GridSlam(SCENE, seed=1)
    for scan in list(gs.simulate(SCENE, "agent1", 1))[:5]:
        slam.step(scan)
        assert slam.state.calibration.gain == 1


def test_what_is_out_of_sight_for_long_is_no_faint_line_of_sight():
    heard, track = gs.simulate(SCENE, "agent1", 4), SCENE.track("agent1").position_m[:, :2]
    far = np.linalg.norm(track[heard.step] - SCENE.anchor_positions[heard.anchor, :2], axis=1)
    hidden = replace(
        heard,
        amplitude=np.where((np.abs(heard.distance_m - far) < 0.1) & (heard.step < 10), 1e-3, heard.amplitude),
    )
    slam = gs.GridSlam(SCENE, seed=4)
    gains = []
    for scan in hidden:
        loud = scan.amplitude > 0.01
        slam.step(
            gs.Scan(
                scan.step,
                scan.time_s,
                *(
                    getattr(scan, name)[loud]
                    for name in ("anchor", "distance_m", "aod_rad", "aoa_rad", "amplitude")
                ),
            )
        )
        gains.append(slam.state.calibration.gain)
    assert set(gains) == {1.0}


class TestRatios:
    """Lines of sight by hand: shares of the amplitude that is stated, with what noise adds."""

    scene = gs.Scene.load("room")

    def ratio(self, amplitude=None, distance_m=0.0, turned=0.0, facing=0.0, spread_m=0.1, anchors=(0,)):
        slam = gs.GridSlam(self.scene, seed=1)
        model, state = slam.model, slam.state
        mean, covariance = state.belief.mean.copy(), np.diag([spread_m**2, spread_m**2, 0.01, 0.01, 0.01])
        state = state.believing(replace(state.belief, mean=mean, covariance=covariance))
        rows = []
        for n, j in enumerate(anchors):
            away = mean[:2] - model.places[j, :2]
            length = float(np.hypot(*away))
            bearing = np.arctan2(away[1], away[0])
            level = model.radio.amplitude_at_1m / length
            loud = np.hypot((amplitude or (0.5,))[n] * level, np.sqrt(0.5))
            rows.append(
                (
                    j,
                    length + distance_m,
                    bearing - model.places[j, 2] + turned,
                    bearing + np.pi - mean[4] + facing,
                    loud,
                )
            )
        columns = [np.array(column) for column in zip(*rows, strict=True)]
        scan = gs.Scan(0, 0.0, columns[0].astype(int), *columns[1:])
        return likeliest_gain(state, 0.0, split_by_anchor(scan, model), model)[0]

    def test_half_as_loud_is_half(self):
        assert self.ratio() == pytest.approx(0.5, rel=1e-6)

    def test_the_loudest_of_several_counts_since_walls_make_fainter(self):
        assert self.ratio((0.3, 0.6), anchors=(0, 1)) == pytest.approx(0.6, rel=1e-6)

    def test_only_what_lies_where_a_line_of_sight_does_counts(self):
        assert self.ratio(distance_m=0.6) == 1.0
        assert self.ratio(turned=0.6) == 1.0

    def test_arrivals_are_as_vague_as_the_heading_is(self):
        """By the radio alone 0.3 is near; with a heading known to 0.1 0.55 is, and 0.9 isn't."""
        assert self.ratio(facing=0.55) == pytest.approx(0.5, rel=1e-6)
        assert self.ratio(facing=0.9) == 1.0

    def test_from_a_vague_place_nothing_is_one(self):
        assert self.ratio(spread_m=0.75) == 1.0
