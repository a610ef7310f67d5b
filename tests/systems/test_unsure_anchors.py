"""Anchors of which the scene says how well it is known how they stand: found with the rest, and claimed."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scene_samples import raised, shortened
from unsure_anchors import PLACE, TURN, drawn, stepped, stood

import gridslam as gs
from gridslam.errors import InputError
from gridslam.inference.management.free_turn import position_spread
from gridslam.inference.messages.anchor_frames import as_believed
from gridslam.systems.registry import METHODS, method_class


def run_of(told, aside, seed, method="grid"):
    what = {"what": "signal"} if method == "direct_grid" else {}
    heard = gs.simulate(stood(told, len(told.track("agent1").time_s), aside=aside), "agent1", seed, **what)
    heard = replace(heard, anchor_position_m=None, anchor_orientation_rad=None)
    return gs.map_scene(told, heard, method=method, seed=seed)


def squares(run, scene):
    """Squared errors over claimed variances, from step 10 on."""
    error = run.trajectory.position_m[:, :2] - scene.track("agent1").position_m[:, :2]
    own = np.linalg.inv(run.covariance[:, :2, :2])
    return float(np.einsum("ki,kij,kj->k", error, own, error)[10:].mean())


@pytest.mark.slow
@pytest.mark.parametrize(("method", "turn"), [("grid", TURN), ("adaptive", 0.0)])
def test_what_is_told_of_anchors_is_claimed_and_they_are_found(method, turn):
    """As a batch: of the agent 2 is right, of anchors' places 1. Where all stand aside by the same, nothing
    tells but the start, so these are draws whose means are as large as usual."""
    told, each, off = stood(steps=35, place=PLACE, turn=turn), [], []
    for seed in range(64, 68):
        aside = drawn(seed, turn=turn)
        run = run_of(told, aside, seed, method)
        each.append(squares(run, told))
        assert np.mean([one.health.ok for one in run.estimates]) > 0.9
        for (dx, dy, _), anchor, (x, y) in zip(
            aside, run.estimates[-1].anchors.values(), told.anchor_positions, strict=True
        ):
            off += [(*(anchor.position_m - [x + dx, y + dy]) / anchor.position_std_m * np.sqrt(2),)]
            if turn:
                assert anchor.orientation_std_rad < np.radians(TURN)
            else:
                assert anchor.orientation_std_rad == 0
    assert 0.2 < np.mean(each) < 4.5
    assert 0.15 < np.square(off).mean() < 2.2
    blind = stood(steps=35)
    assert squares(run_of(blind, drawn(64, turn=turn), 64, method), blind) > 8


@pytest.mark.slow
def test_samples_tell_how_anchors_stand_too():
    told = stood("chamber", 15, place=PLACE, turn=TURN)
    aside = drawn(3, anchors=len(told.anchors))
    run = run_of(told, aside, 3, "direct_grid")
    assert squares(run, told) < 8
    assert squares(run_of(stood("chamber", 15), aside, 3, "direct_grid"), told) > 20


@pytest.mark.slow
def test_heights_are_found_beside():
    scene = raised(shortened(gs.Scene.load("room"), 40), [1.5, 1.1])
    data = scene.model_dump(exclude_none=True)
    data["agents"][0]["height_std_m"] = 0.05
    told = stood(gs.Scene.checked(data, "room"), 40, place=0.05)
    run = run_of(told, drawn(8, 0.05, 0.0), 8)
    assert run.estimates[-1].heights
    assert squares(run, told) < 8


def test_known_anchors_change_nothing_and_are_not_told():
    scene = stood(steps=4)
    run = gs.map_scene(scene, gs.simulate(scene, "agent1", 1), seed=1)
    assert run.estimates[-1].anchors == {}
    assert "anchors" not in run.score(None)
    assert gs.GridSlam(scene).state.mountings is None


@pytest.mark.parametrize("name", sorted(METHODS))
def test_methods_that_take_places_as_they_are_say_so(name):
    method = method_class(name)
    bundled = {"network": "exchange", "signal": "screen"}
    kind = "network" if name.startswith("network") else "signal" if METHODS[name].takes != "paths" else ""
    scene = stood(bundled.get(kind, "room"), 4, place=0.1)
    if getattr(method, "finds_places", False):
        assert name in {"grid", "adaptive", "direct_grid"}
        return
    with pytest.raises(
        InputError, match=r"anchors\[0\].position_std_m: found 0.1, for .*; allowed: 0, or grid"
    ):
        method(scene)


def test_and_so_do_particles_and_gaussians_apart():
    for settings in ({"representation": "particles"}, {"correlated": False}):
        with pytest.raises(InputError, match="position_std_m"):
            gs.GridSlam(stood(steps=4, place=0.1).with_filter(**settings))


def test_the_command_line_says_where_anchors_stand(say, tmp_path, no_figures):
    (tmp_path / "s.toml").write_text(stood(steps=6, place=0.1, turn=1.0).to_toml())
    told = say("run", "s.toml", "-o", "out", "--agent", "agent1")
    assert told.code == 0
    assert "agent1: anchor A stands at (" in told.out + told.err
    summary = json.loads((tmp_path / "out" / "run.json").read_text())
    anchor = summary["agents"]["agent1"]["anchors"]["A"]
    assert set(anchor) == {"x_m", "y_m", "position_std_m", "orientation_deg", "orientation_std_deg"}
    assert 0 < anchor["position_std_m"] < 0.15
    refused = say("run", "s.toml", "-o", "other", "--method", "va")
    assert (refused.code, len(refused.complaints)) == (2, 1)
    assert "position_std_m" in refused.err
    (tmp_path / "bad.toml").write_text(
        (tmp_path / "s.toml").read_text().replace("position_std_m = 0.1", "position_std_m = -1")
    )
    refused = say("run", "bad.toml", "-o", "third")
    assert (refused.code, len(refused.complaints)) == (2, 2)  # of each anchor


@pytest.mark.parametrize("method", [gs.GridSlam, gs.AdaptiveSlam])
def test_it_goes_on_from_its_checkpoint_bit_for_bit(method, tmp_path):
    scene = stood(steps=8, place=0.1, turn=2.0)
    scans = list(gs.simulate(scene, "agent1", 2))
    slam = method(scene, seed=2)
    for scan in scans[:5]:
        slam.step(scan)
    slam.save(tmp_path / "state.h5")
    other = method.resume(tmp_path / "state.h5")
    for scan in scans[5:]:
        here, there = slam.step(scan), other.step(scan)
        np.testing.assert_array_equal(here.position_m, there.position_m)
        np.testing.assert_array_equal(here.covariance, there.covariance)
        assert here.anchors["A"].position_std_m == there.anchors["A"].position_std_m


@pytest.mark.parametrize(
    ("part", "value", "says"),
    [
        ("mean", np.zeros(3), "3 numbers for each anchor"),
        ("turn_variance", -1.0, "0 or more"),
        ("cross", None, "covariances that are possible"),
    ],
)
def test_mountings_that_cannot_be_are_refused(part, value, says):
    slam = gs.GridSlam(stood(steps=4, place=0.1, turn=2.0))
    own = slam.state.mountings
    value = np.full_like(own.cross, 10.0) if value is None else value
    spoilt = replace(slam.state, mountings=replace(own, **{part: value}))
    with pytest.raises(InputError, match=says):
        slam.require_sound(replace(slam.population, states=(spoilt,)), slam.model, "file")


def test_a_turn_of_all_is_no_part_of_the_belief_and_of_all_that_is_reported():
    slam, estimate = stepped(place=PLACE, turn=TURN)
    own, belief = slam.state.mountings, slam.state.belief
    x, y = belief.mean[:2] - own.pivot
    assert own.turn_variance > np.radians(0.5) ** 2
    wanted = belief.covariance[:2, :2] + own.turn_variance * np.outer([-y, x], [-y, x])
    np.testing.assert_allclose(estimate.covariance[:2, :2], wanted, rtol=1e-9)
    assert position_spread(slam.state, slam.model) == pytest.approx(np.sqrt(np.trace(wanted)))
    table = slam.map().surfaces
    assert len(table) == estimate.detected.sum() > 0
    assert (table.line_cov[:, 0, 0] > own.turn_variance).all()


def test_a_start_is_as_wide_as_it_may_be_turned_against_the_anchors():
    for anchors in (2, 1):
        slam = gs.GridSlam(stood("room" if anchors == 2 else one_anchor(), 4, PLACE, TURN))
        own, wide = slam.state.mountings, np.diag(slam.state.belief.covariance)[[0, 1, 4]]
        x, y = slam.state.belief.mean[:2] - own.pivot
        more = own.turn_variance * np.array([y * y, x * x, 1.0]) if anchors == 2 else 0.0
        np.testing.assert_allclose(wide, slam.model.start_variance[[0, 1, 4]] + more)


def one_anchor():
    scene = gs.Scene.load("room")
    return scene.model_copy(update={"anchors": scene.anchors[:1]})


def test_turns_by_sums_are_not_looked_for_beside():
    slam, _ = stepped(place=PLACE)
    assert not slam.state.calibration.turn.any()
    blind, _ = stepped()
    assert blind.state.calibration.turn.all()


def test_searches_have_anchors_where_they_are_believed_to_stand_and_once():
    slam, _ = stepped(place=PLACE, turn=TURN)
    for model in (
        as_believed(slam.model, slam.state),
        as_believed(as_believed(slam.model, slam.state), slam.state),
    ):
        np.testing.assert_allclose(model.anchors - slam.model.anchors, slam.state.aside, atol=1e-12)
    assert as_believed(slam.model, replace(slam.state, mountings=None)) is slam.model


def test_a_place_that_is_found_is_known_as_anchors_are():
    slam, _ = stepped(place=PLACE, turn=TURN)
    sharp = slam.state.belief.covariance.copy()
    sharp[:5], sharp[:, :5] = 0.0, 0.0
    sharp[:5, :5] = 1e-6 * np.eye(5)
    state = slam.state.placed(replace(slam.state.belief, covariance=sharp))
    assert np.sqrt(np.diag(state.belief.covariance)[:2]).min() > 0.02
    joint = np.block(
        [
            [state.belief.covariance, state.mountings.cross.T],
            [state.mountings.cross, state.mountings.covariance],
        ]
    )
    scale = np.sqrt(np.diag(joint))
    assert np.linalg.eigvalsh(joint / np.outer(scale, scale)).min() > -1e-9
