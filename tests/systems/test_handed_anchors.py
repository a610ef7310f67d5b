"""Where anchors stand, from one agent's map to the next agent, to scenes surveyed since, and to pictures."""

from dataclasses import replace

import numpy as np
import pytest
from unsure_anchors import PLACE, TURN, drawn, stepped, stood

import gridslam as gs
from gridslam.drawing.map_figure import draw_map
from gridslam.errors import InputError
from gridslam.estimate_tables import FeatureEstimate
from gridslam.maps.feature_rows import SAME_PLACE_M
from gridslam.maps.frames import fitted
from gridslam.systems.handed_anchors import learned_anchors, map_anchors


def next_agent(made, told):
    """An agent of the same anchors with a map, before its first step and after its last."""
    slam = gs.GridSlam(told, prior_map=made, seed=5, same_frame=True)
    begun = slam.state.mountings
    for scan in gs.simulate(stood(steps=6, aside=drawn(64)), "agent1", 5):
        estimate = slam.step(scan)
    return begun, estimate


def test_the_next_agent_begins_with_anchors_as_the_first_one_found_them():
    slam, estimate = stepped(place=PLACE, turn=TURN)
    begun, _ = next_agent(slam.map(), stood(steps=6, place=PLACE, turn=TURN))
    ended = slam.state.mountings
    np.testing.assert_allclose(begun.mean, ended.mean, atol=1e-12)
    np.testing.assert_allclose(begun.covariance, ended.covariance, atol=1e-8)
    assert begun.turn_variance == pytest.approx(ended.turn_variance, rel=1e-4)
    made = slam.map().anchors
    assert made.names == tuple(estimate.anchors)
    for (*own, std_x, std_y, turn_std), found in zip(made.columns.T, estimate.anchors.values(), strict=True):
        np.testing.assert_allclose(own, [*found.position_m, found.orientation_rad])
        claimed = [found.position_std_m, found.orientation_std_rad]
        np.testing.assert_allclose([np.hypot(std_x, std_y), turn_std], claimed)


def test_a_line_is_handed_on_alike_from_either_side():
    """Its offset is 0 or more in a map, so what is correlated with it changes its sign with it."""
    slam, _ = stepped(place=PLACE, turn=TURN)
    state, whole = slam.state, np.ones(len(slam.state.surfaces), bool)
    offset = state.belief.layout.head + 1
    sign, mean = np.ones(len(state.belief.mean)), state.belief.mean.copy()
    sign[offset] = -1.0
    mean[offset - 1 : offset + 1] = mean[offset - 1] + np.pi, -mean[offset]
    turned = replace(
        state,
        belief=replace(state.belief, mean=mean, covariance=state.belief.covariance * np.outer(sign, sign)),
        mountings=replace(state.mountings, cross=state.mountings.cross * sign),
    )
    one, other = (map_anchors(own, whole, slam.model).cross for own in (state, turned))
    assert np.abs(one[:, 1]).max() > 1e-4
    np.testing.assert_allclose(other, one, atol=1e-12)


def test_maps_that_such_anchors_made_do_not_tell_where_they_stand():
    """Claims shrink by what the next agent's own start tells alone: the same anchors are off by the same."""
    slam, first = stepped(place=0.3)
    told = stood(steps=6, place=0.3)
    claimed, open_ = first.anchors["A"].position_std_m, 2 * 0.3**2 / 2
    # of what two anchors have in common, which nothing that is heard tells; each start does as much
    by_start = 1 / claimed**2 - 1 / open_
    twice = (1 / open_ + 2 * by_start) ** -0.5
    _, estimate = next_agent(slam.map(), told)
    assert estimate.anchors["A"].position_std_m == pytest.approx(twice, rel=0.03)
    earlier = replace(slam.map(), anchors=None)  # of an earlier version, or fused
    assert next_agent(earlier, told)[1].anchors["A"].position_std_m > 0.9 * claimed
    plan = replace(slam.map(), provenance={}, anchors=None)  # read from elsewhere: walls tell it
    assert next_agent(plan, told)[1].anchors["A"].position_std_m < 0.9 * claimed


def test_who_knows_anchors_takes_their_walls_alone():
    slam, _ = stepped(place=PLACE, turn=TURN)
    begun, estimate = next_agent(slam.map(), stood(steps=6))
    assert begun is None
    assert not estimate.anchors


def test_a_map_that_lacks_one_of_the_anchors_tells_nothing_of_any():
    """It may have told its walls before, by an agent before the map's maker: (M569)."""
    slam, _ = stepped(place=PLACE, turn=TURN)
    made = slam.map()
    for order in ([1, 0], [0]):
        entries = np.add.outer(3 * np.array(order), np.arange(3)).ravel()
        other = replace(
            made.anchors, names=tuple(made.anchors.names[n] for n in order),
            position_m=made.anchors.position_m[order], orientation_rad=made.anchors.orientation_rad[order],
            covariance=made.anchors.covariance[np.ix_(entries, entries)], cross=made.anchors.cross[entries],
        )  # fmt: skip
        found = learned_anchors(replace(made, anchors=other), slam.model)
        if len(order) == 1:
            assert found is None
            continue
        whole = learned_anchors(made, slam.model)
        for ours, theirs in zip(found, whole, strict=True):
            np.testing.assert_array_equal(ours, theirs)
        np.testing.assert_allclose(whole.aside, slam.state.aside, atol=1e-12)
    assert learned_anchors(replace(made, surfaces=None, surface_covariance=None, surface_reflection=None,
                                   anchors=None, stretches=None), slam.model) is None  # fmt: skip


def test_after_a_silence_anchors_are_known_no_better():
    """Who is found by anchors is off by what they have in common, and so doesn't tell it; nor do walls."""
    told, squares_of = stood(steps=26, place=PLACE, turn=TURN), []
    for seed in range(4):
        heard = gs.simulate(stood(steps=26, aside=drawn(80 + seed)), "agent1", seed)
        slam, truth = gs.GridSlam(told, seed=seed), told.track("agent1").position_m
        for number, scan in enumerate(heard):
            if number in (14, 15):
                continue
            scan = replace(scan, time_s=scan.time_s + (3600.0 if number > 15 else 0.0))
            estimate = slam.step(scan)
            if number == 13:
                before = estimate.anchors["A"].position_std_m
            if number == 16:
                assert estimate.anchors["A"].position_std_m > 0.95 * before
        error = estimate.position_m[:2] - truth[number, :2]
        squares_of.append(error @ np.linalg.solve(estimate.covariance[:2, :2], error))
    assert np.mean(squares_of) < 4.5


@pytest.mark.parametrize("method", [gs.GridSlam, gs.AdaptiveSlam])
def test_an_only_anchor_is_read_again_as_it_was_written(method, tmp_path):
    told = stood(steps=6, turn=TURN)
    told = gs.Scene.checked(told.model_dump(exclude_none=True) | {
        "anchors": [told.anchors[0].model_dump(exclude_none=True)]}, "room")  # fmt: skip
    made = None
    for seed in (1, 2):
        slam = method(told, seed=seed, prior_map=made)
        for scan in list(gs.simulate(told, "agent1", seed))[:4]:
            slam.step(scan)
        slam.save(tmp_path / "one.h5")
        again = method.resume(tmp_path / "one.h5").state.mountings
        np.testing.assert_array_equal(again.covariance, slam.state.mountings.covariance)
        assert again.covariance[2, 2] == 0  # its turn is that of all
        made = slam.map()


def features_of(scene):
    """One feature of each anchor."""
    count = len(scene.anchors)
    zeros = np.zeros(count)
    table = {"identity": np.arange(count), "anchor": np.arange(count), "anchor_m": scene.anchor_positions,
             "position_m": np.ones((count, 2)), "bias_m": zeros, "variance": zeros + 1, "noise": zeros + 1,
             "covariance": np.tile(np.eye(4), (count, 1, 1)), "kind": np.zeros(count, int),
             "steps_seen": np.ones(count, int), "last_step": np.zeros(count, int)}  # fmt: skip
    return FeatureEstimate(**table)


def moved_anchors(scene, learned, share, place=0.0, turn=0.0):
    """A scene with anchors a share of the way (of x and y) to where they were learned to stand."""
    data = scene.model_dump(exclude_none=True)
    for anchor, x, y in zip(data["anchors"], *learned.columns[:2], strict=True):
        there = np.array(anchor["position_m"][:2])
        anchor["position_m"] = (there + np.array(share) * (np.array([x, y]) - there)).tolist()
        anchor |= {"position_std_m": place, "orientation_std_deg": turn}
    return gs.Scene.checked(data, data["name"])


@pytest.mark.parametrize("told", [{}, {"place": PLACE, "turn": TURN}])
def test_a_map_fits_a_scene_whose_anchors_were_surveyed_since(told):
    slam, _ = stepped(place=PLACE, turn=TURN)
    made = slam.map()
    surveyed = moved_anchors(slam.scene, made.anchors, 1.0, **told)
    assert np.hypot(*(surveyed.anchor_positions - slam.scene.anchor_positions).T).min() > SAME_PLACE_M
    begun = gs.GridSlam(surveyed, prior_map=made).state.mountings
    if told:  # there already, and as sure
        np.testing.assert_allclose(begun.aside[:, :2], 0, atol=1e-9)
        np.testing.assert_allclose(begun.aside[:, 2], slam.state.aside[:, 2], atol=1e-9)
    at_once = fitted(replace(made, features=features_of(slam.scene)), surveyed)
    np.testing.assert_allclose(at_once[0].features.anchor_m, surveyed.anchor_positions)
    assert "its anchor A is the scene's, 0.01" in at_once[1]
    with pytest.raises(InputError, match="map: frame: found anchor 'A' at"):  # where one of them isn't
        gs.GridSlam(moved_anchors(slam.scene, made.anchors, [1.0, 80.0], **told), prior_map=made)
    with pytest.raises(InputError, match="map: frame: found anchor 'A' at"):  # where none of them is
        gs.GridSlam(moved_anchors(slam.scene, made.anchors, 80.0, **told), prior_map=made)
    with pytest.raises(InputError, match="map: frame: found anchor 'A' at"):  # known, by its maker
        gs.GridSlam(surveyed, prior_map=replace(made, anchors=None))


def test_the_map_is_drawn_with_anchors_where_they_were_found():
    slam, _ = stepped(place=PLACE, turn=TURN)
    for made, wanted in ((slam.map(), 1), (replace(slam.map(), anchors=None), 0)):
        _, labels = draw_map(made, slam.scene).axes[0].get_legend_handles_labels()
        assert labels.count("anchors as found, 2 deviations") == wanted
