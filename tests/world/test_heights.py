"""Anchors above the agent: lengths, slopes and angles by hand and in space, and what a scene may say."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scene_samples import raised, shortened

import gridslam as gs
from gridslam.errors import InputError
from gridslam.importers.raytracers import TracedPaths, plane_table
from gridslam.simulation.image_source import simulate_labelled, true_paths
from gridslam.systems.hybrid import HybridSlam
from gridslam.systems.published.refa import PublishedVirtualAnchorSlam
from gridslam.world.geometry import lean, level_of, slant, trace, unit
from gridslam.world.radio import SPEED_OF_LIGHT

ROOM = gs.Scene.load("room")
seeds = st.integers(0, 2**32 - 1)


def test_an_anchor_one_and_a_half_metres_up_two_metres_away_is_heard_at_two_and_a_half():
    line = np.zeros((1, 2))
    path = trace(np.array([[2.0, 0.0]]), np.zeros((1, 2)), line, line, np.zeros(1, int), 1.5)
    assert path.distance[0] == 2.5
    assert path.level[0] == 2.0
    np.testing.assert_allclose(path.jacobian[0, 0, :2], [0.8, 0.0], atol=1e-12)  # cos(elevation)
    np.testing.assert_allclose(
        path.jacobian[0, 2, :2], [0.0, 0.5], atol=1e-12
    )  # azimuths know nothing of heights
    assert lean(2.5, -1.5) == pytest.approx(0.8)


def test_a_bounce_keeps_the_difference_of_heights():
    # wall x = 3: from (0, 0) by (3, 2) to (0, 4) seen from above, 2 sqrt(13) long, 1.5 m up
    line = np.array([[0.0, 3.0]])
    path = trace(np.array([[0.0, 4.0]]), np.zeros((1, 2)), line, line, np.ones(1, int), 1.5)
    assert path.distance[0] == pytest.approx(np.sqrt(4 * 13 + 2.25))
    np.testing.assert_allclose(path.last_point[0], [3.0, 2.0])


@given(seeds, st.integers(0, 2))
@settings(max_examples=100, deadline=None)
def test_lengths_are_those_of_images_in_space_and_slopes_their_differences(seed, bounces):
    draw = np.random.default_rng(seed)
    state = np.concatenate([draw.uniform(-4, 4, 2), [0.3], draw.uniform(-3, 3, 2), draw.uniform(-3, 3, 2)])
    state[[4, 6]] += 7.0
    anchor, height = draw.uniform(-4, 4, 2), draw.uniform(-3, 3)

    def length(at):
        place = np.array([*anchor, height])
        for angle, offset in [at[5:7], at[3:5]][2 - bounces :]:
            normal = np.array([np.cos(angle), np.sin(angle), 0.0])  # a vertical plane
            place = place + 2 * (offset - normal @ place) * normal
        return np.linalg.norm(place - np.array([*at[:2], 0.0]))

    path = trace(
        state[None, :2], anchor[None], state[None, 3:5], state[None, 5:7], np.array([bounces]), height
    )
    assert path.distance[0] == pytest.approx(length(state))
    assert slant(level_of(path.distance, height), height) == pytest.approx(path.distance)
    step = 1e-6 * np.eye(7)
    slopes = [(length(state + s) - length(state - s)) / 2e-6 for s in step]
    used = [0, 1, 2, *([3, 4] if bounces else []), *([5, 6] if bounces == 2 else [])]
    np.testing.assert_allclose(path.jacobian[0, 0, used], np.array(slopes)[used], atol=1e-6)


def test_simulated_paths_run_in_space_with_amplitudes_by_their_length():
    scene = raised(ROOM, [1.5, -0.4])
    flat, tall = true_paths(ROOM, "agent1"), true_paths(scene, "agent1")
    np.testing.assert_allclose(tall.distance_m, np.hypot(flat.distance_m, np.array([1.5, 0.4])[flat.anchor]))
    np.testing.assert_allclose(tall.amplitude * tall.distance_m, flat.amplitude * flat.distance_m)
    for name in ("aod_rad", "aoa_rad", "points", "segment"):
        np.testing.assert_array_equal(getattr(tall, name), getattr(flat, name))


@pytest.mark.slow
def test_azimuths_are_as_rough_as_a_steep_path_leaves_them():
    scene = raised(shortened(ROOM, 60), 3.0)
    radio, paths = scene.signal_model("agent1"), true_paths(scene, "agent1")
    gaps = []
    for seed in range(20):
        measurements, cause = simulate_labelled(scene, "agent1", seed)
        rows = cause >= 0
        own, gap = cause[rows], measurements.aoa_rad[rows] - paths.aoa_rad[cause[rows]]
        steep = np.sqrt(1 - (3.0 / paths.distance_m[own]) ** 2)
        std = radio.angle_std(paths.amplitude[own], paths.aoa_rad[own], radio.agent_aperture) / steep
        gaps.append((np.remainder(gap + np.pi, 2 * np.pi) - np.pi) / std)
    assert np.concatenate(gaps).std() == pytest.approx(1.0, abs=0.02)


def test_heights_of_some_devices_alone_are_refused_in_one_line():
    data = raised(ROOM, 1.5).model_dump(exclude_none=True)
    for change, words in (
        (lambda d: d["agents"][0].pop("height_m"), r"agents\[0\].height_m: found none; allowed"),
        (lambda d: d["anchors"][1].update(position_m=(2.9, -2.3)), r"anchors\[1\].position_m: .*x, y, z"),
        (
            lambda d: [a.update(position_m=a["position_m"][:2]) for a in d["anchors"]],
            "no anchor has a height",
        ),
        (lambda d: d["anchors"][0].update(position_m=(1.0,)), r"anchors\[0\].position_m"),
        (lambda d: d["anchors"][0].update(position_m=(1.0, 2.0, 3.0, 4.0)), r"anchors\[0\].position_m"),
    ):
        spoilt = {**data, "anchors": [dict(a) for a in data["anchors"]], "agents": [dict(data["agents"][0])]}
        change(spoilt)
        with pytest.raises(InputError, match=words) as error:
            gs.Scene.checked(spoilt, "room")
        assert "\n" not in str(error.value)


def test_a_scene_with_heights_reads_back_equal():
    scene = raised(ROOM, [1.5, 2.0])
    assert gs.Scene.from_toml(scene.to_toml()) == scene
    np.testing.assert_allclose(scene.heights("agent1"), [1.5, 2.0])
    assert scene.anchor_positions.shape == (2, 2)


def test_methods_that_know_no_heights_refuse_them():
    scene = raised(gs.Scene.load("screen"), 1.0)
    for attempt in (
        lambda: gs.simulate(scene, "agent1", 1, what="signal"),
        lambda: HybridSlam(scene),
        lambda: PublishedVirtualAnchorSlam(raised(ROOM, 1.0)),
        lambda: HybridSlam(scene, waveform=gs.Scene.load("screen").waveform()),
    ):
        with pytest.raises(InputError, match="planar"):
            attempt()


def test_ray_traced_lengths_stay_as_they_are_and_floor_and_ceiling_are_left_out():
    scene = raised(ROOM, 1.5)
    # line of sight at 2 m; over floor and ceiling, down and up, of the same slope at both ends
    length = np.array([[[2.5, 9.0]] * 2])
    zenith = np.pi / 2 + np.arcsin([1.5 / 2.5, 7.5 / 9.0])
    same = np.zeros((1, 2, 2))
    paths = TracedPaths(
        length / SPEED_OF_LIGHT, same, same + np.pi, same + zenith, same + np.pi - zenith, same + 1e-3
    )
    table = plane_table(paths, scene, 0.0)
    np.testing.assert_allclose(table["distance_m"]["A"], [[2.5, np.nan]])
    flat = plane_table(paths, ROOM, 0.0, slope_deg=40.0)
    np.testing.assert_allclose(flat["distance_m"]["A"], [[2.0, np.nan]])


def test_directions_of_images_are_those_of_the_plane():
    scene = raised(ROOM, 1.5)
    paths = true_paths(scene, "agent1").at(0)
    track = scene.track("agent1")
    ground = level_of(paths.distance_m, 1.5)
    sight = paths.bounces == 0
    toward = unit(track.heading_rad[0] + paths.aoa_rad[sight])
    np.testing.assert_allclose(
        track.position_m[0] + ground[sight, None] * toward, scene.anchor_positions[paths.anchor[sight]]
    )


@pytest.mark.parametrize(
    ("tall", "says"),
    [
        (
            (False, True, True),
            r"anchors\[0\].position_m: found \[0.5, 1.0\] \(anchor A\); allowed: \[x, y, z\]",
        ),
        (
            (False, True, False),
            r"anchors\[1\].position_m: found \[1.5, 1.0, 2.0\] \(anchor B\); allowed: \[x, y\],",
        ),
        ((False, True), r"anchors\[0\].position_m: found .* allowed: \[x, y, z\]"),
    ],
)
def test_the_anchor_that_differs_from_most_is_named(tall, says):
    places = [(0.5 + index, 1.0, *([2.0] if high else [])) for index, high in enumerate(tall)]
    anchors = [{"name": name, "position_m": place} for name, place in zip("ABC", places, strict=False)]
    agents = [{"name": "me", "start_m": (1.0, 2.0), "height_m": 1.0}]
    data = {"grid": {"x_m": (0.0, 4.0), "y_m": (0.0, 4.0)}, "anchors": anchors, "agents": agents}
    with pytest.raises(gs.InputError, match=says):
        gs.Scene.checked(data, "scene")
