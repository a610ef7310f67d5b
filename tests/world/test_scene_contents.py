"""What a scene holds: arrays, walls, grids, settings and tracks."""

import numpy as np
import pytest
import tomli_w
from hypothesis import given, settings
from hypothesis import strategies as st
from scene_worlds import WORLD, changed, drop, put

from gridslam.errors import InputError
from gridslam.world.geometry import distance_to_segments, wrap
from gridslam.world.scene import Scene
from gridslam.world.scene_derived import segments_of, surface_names
from gridslam.world.scene_files import bundled_scenes
from gridslam.world.scene_parts import Wall


@pytest.fixture
def scene():
    return Scene.from_toml(tomli_w.dumps(WORLD), "hall.toml")


def test_defaults_are_the_papers(scene):
    assert (scene.radio.carrier_hz, scene.radio.bandwidth_hz, scene.radio.max_bounces) == (6e9, 1e9, 2)
    assert (scene.radio.array.rows, scene.radio.array.spacing_wavelengths) == (5, 0.25)
    assert (scene.filter.particles, scene.filter.survival, scene.filter.births) == (10_000, 0.999, 0.1)
    assert (scene.agents[0].prior.position_m, scene.agents[0].prior.heading_deg) == (0.5, 10.0)
    assert scene.walls[1].arc.facets == 32


def test_scene_without_agents_or_walls_has_empty_tables():
    scene = Scene.from_toml(changed(lambda w: (w.pop("walls"), w.pop("agents"), w.pop("materials"))))
    walls = scene.segments()
    assert len(walls) == 0
    assert walls.start.shape == (0, 2)
    assert walls.surface.dtype == np.intp
    with pytest.raises(InputError, match="'agent1'; allowed: none"):
        scene.track("agent1")


def test_surfaces_are_called_by_their_walls_and_by_numbers_where_no_name_tells():
    whole = Scene.load("canyon")
    names = surface_names(whole.walls, whole.segments())
    assert names[0] == "north, east of the window", "the longest of three in a line"
    assert names[1:3] == ["curved front, facet 1", "curved front, facet 2"]
    box = Scene.load("room")
    assert surface_names(box.walls, box.segments()) == [f"walls, side {side}" for side in (1, 2, 3, 4)]
    bare = [wall.model_copy(update={"name": None}) for wall in box.walls]
    assert surface_names(bare, box.segments()) == [f"surface {number}" for number in (1, 2, 3, 4)]
    ends = [{"points_m": ((x, -2.0), (x, 2.0)), "material": "brick"} for x in (-2.0, 2.0)]
    alike = [Wall(name="pillar", **wall) for wall in ends]
    twice = surface_names(alike, segments_of(alike, {"brick": 0.5}))
    assert twice == ["pillar (surface 1)", "pillar (surface 2)"]
    assert surface_names([], segments_of([], {})) == []


def test_anchor_angles_are_wrapped_radians(scene):
    np.testing.assert_allclose(scene.anchor_orientations, [np.pi / 2, -np.pi / 2])
    assert scene.anchor_positions.dtype == np.float64
    np.testing.assert_array_equal(scene.anchor_positions, [[-2, 1], [2, 1]])


def test_grid_shape_is_not_off_by_rounding(scene):
    assert scene.grid.shape == (80, 100)
    assert scene.grid.origin_m == (-5.0, -4.0)
    odd = Scene.from_toml(changed(put("grid", "cell_m", 0.3)))
    assert odd.grid.shape == (27, 34)  # the last cells reach beyond the region


def test_arrays_of_anchor_and_agent_override_the_radios():
    def change(world):
        world["anchors"][1]["array"] = {"rows": 3}
        world["agents"][0]["array"] = {"columns": 2, "spacing_wavelengths": 0.5}

    signal = Scene.from_toml(changed(change)).signal_model("agent1")
    np.testing.assert_allclose(signal.anchor_aperture, [[0.125, 0.125], [0.125, 0.125 / 3]])
    np.testing.assert_allclose(signal.agent_aperture, [0.0625, 0.5])
    assert signal.amplitude_at_1m == pytest.approx(31.6227766)
    assert signal.threshold == pytest.approx(1.99526231)


def test_arc_facets_lie_on_the_circle_from_end_to_end(scene):
    walls = scene.segments()
    facets = walls.wall == 1
    assert facets.sum() == 32
    np.testing.assert_allclose(np.linalg.norm(walls.start[facets], axis=1), 3.5)
    np.testing.assert_allclose(walls.start[facets][0], [-3.5, 0], atol=1e-12)
    np.testing.assert_allclose(walls.end[facets][-1], -3.5 * np.sqrt([0.5, 0.5]))
    np.testing.assert_array_equal(walls.end[facets][:-1], walls.start[facets][1:])
    assert len(np.unique(walls.surface[facets])) == 32
    np.testing.assert_array_equal(walls.reflection, np.where(facets, 0.3, 0.7))


def test_closed_wall_joins_its_ends():
    wall = {"material": "glass", "points_m": [[-1.0, 2.0], [1.0, 2.0], [1.0, 2.5]], "closed": True}
    walls = Scene.from_toml(changed(put("walls", [wall]))).segments()
    np.testing.assert_array_equal(walls.start, [[-1, 2], [1, 2], [1, 2.5]])
    np.testing.assert_array_equal(walls.end, [[1, 2], [1, 2.5], [-1, 2]])


@given(
    angle=st.floats(-3, 3),
    offset=st.floats(-2, 2),
    shift=st.sampled_from([0.0, 1e-8, 1e-4]),
    flipped=st.booleans(),
)
@settings(max_examples=25, deadline=None)
def test_window_shares_the_surface_of_its_wall_and_a_shifted_wall_does_not(angle, offset, shift, flipped):
    normal, tangent = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
    ends = [offset * normal + along * tangent for along in (-2.0, -0.5, 0.5, 2.0)]
    last = [ends[2] + shift * normal, ends[3] + shift * normal]
    pieces = [ends[0:2], ends[1:3], last[::-1] if flipped else last, [ends[0], ends[0] + normal]]
    walls = [{"material": "glass", "points_m": [p.tolist() for p in piece]} for piece in pieces]
    world = {**WORLD, "walls": walls, "agents": [], "anchors": [{"name": "A", "position_m": [4.99, 3.99]}]}
    surface = Scene.from_toml(tomli_w.dumps(world)).segments().surface
    assert surface.tolist() == ([0, 0, 0, 1] if shift < 1e-6 else [0, 0, 1, 2])


def test_resolved_scene_reads_back_equal(scene):
    again = Scene.from_toml(scene.to_toml(), "elsewhere.toml")
    assert again == scene
    assert again.name == "hall"
    assert "particles = 10000" in scene.to_toml()


@pytest.mark.slow
@given(
    cell=st.floats(0.01, 1.0),
    coefficient=st.floats(1e-6, 1.0),
    particles=st.integers(1, 10**7),
    description=st.text(st.characters(codec="utf-8"), max_size=30),
)
@settings(max_examples=25, deadline=None)
def test_any_valid_numbers_and_text_survive_the_file(cell, coefficient, particles, description):
    def change(world):
        world["grid"]["cell_m"], world["materials"]["glass"] = cell, coefficient
        world["filter"], world["description"] = {"particles": particles}, description

    scene = Scene.from_toml(changed(change))
    assert Scene.from_toml(scene.to_toml()) == scene
    assert (scene.grid.cell_m, scene.description) == (cell, description)


def test_filter_settings_change_in_a_copy_alone(scene):
    other = scene.with_filter(particles=50, births=0.2)
    assert (other.filter.particles, other.filter.births, scene.filter.particles) == (50, 0.2, 10_000)
    assert other.anchors == scene.anchors
    with pytest.raises(InputError, match=r"hall: filter\.particels.*particles"):
        scene.with_filter(particels=5)
    with pytest.raises(InputError, match=r"hall: filter\.particles: found 0"):
        scene.with_filter(particles=0)


def test_filter_settings_do_not_move_the_truth(scene):
    other = scene.with_filter(heading_deg=2.0, acceleration_mps2=0.01)
    assert other.track("agent1") == scene.track("agent1")


@pytest.mark.parametrize("name", bundled_scenes())
def test_a_filter_that_expects_slow_turns_leaves_the_bundled_tracks_alone(name):
    scene = Scene.load(name)
    other = scene.with_filter(acceleration_mps2=0.003)
    for agent in scene.agents:
        assert other.track(agent.name) == scene.track(agent.name)


def test_agent_without_waypoints_loads_but_has_no_track():
    scene = Scene.from_toml(changed(drop("agents", 0, "waypoints_m")))
    with pytest.raises(InputError, match=r"agents\[0\]\.waypoints_m: found none"):
        scene.track("agent1")


def test_unknown_agent_names_the_known(scene):
    with pytest.raises(InputError, match="'agent7'; allowed: agent1"):
        scene.agent("agent7")


def test_start_repeated_as_waypoint_counts_once(scene):
    points = [[0.0, 0.0], [2.0, 0.0], [2.0, -2.0]]
    again = Scene.from_toml(changed(put("agents", 0, "waypoints_m", points)))
    assert again.track("agent1") == scene.track("agent1")


def test_steps_cut_the_track(scene):
    short = Scene.from_toml(changed(put("agents", 0, "steps", 7))).track("agent1")
    assert len(short) == 7
    np.testing.assert_array_equal(short.position_m, scene.track("agent1").position_m[:7])


def test_track_keeps_its_speed_and_turns_no_faster_than_the_filter_can_follow(scene):
    track, body = scene.track("agent1"), scene.agent("agent1")
    np.testing.assert_array_equal(track.position_m[0], body.start_m)
    np.testing.assert_allclose(np.diff(track.time_s), body.interval_s)
    speed = np.linalg.norm(track.velocity_mps, axis=1)
    np.testing.assert_allclose(speed, body.step_m / body.interval_s)
    strides = np.diff(track.position_m, axis=0)
    np.testing.assert_allclose(np.linalg.norm(strides, axis=1), body.step_m, rtol=2e-3)  # chord of an arc
    midway = 0.5 * (track.velocity_mps[1:] + track.velocity_mps[:-1]) * body.interval_s
    np.testing.assert_allclose(strides, midway, atol=1e-2 * body.step_m)
    assert np.degrees(np.abs(wrap(np.diff(track.heading_rad)))).max() <= scene.filter.heading_deg
    assert np.linalg.norm(np.diff(track.velocity_mps, axis=0), axis=1).max() <= scene.filter.acceleration_mps2
    assert np.degrees(track.heading_rad[-1]) == pytest.approx(-90)
    ends = distance_to_segments(
        track.position_m, np.array([[0.0, 0.0], [2, 0]]), np.array([[2.0, 0], [2, -2]])
    )
    assert ends.min(axis=1).max() < 0.5  # the corner is cut, no more


def test_fast_agent_turns_wider(scene):
    def hurry(world):
        world["agents"][0].update(interval_s=0.2)  # 0.25 m/s: 0.8 m would be 2.6 standard deviations

    says = r"waypoints_m\[0\]: found room to turn with .* 1 m at \(2, 0\); .* or a step_m of 0\.034 or less"
    with pytest.raises(InputError, match=says):
        Scene.from_toml(changed(hurry))  # the corner itself, not the start

    def eagerly(world):
        hurry(world)
        world["agents"][0]["acceleration_mps2"] = 0.07

    eager = Scene.from_toml(changed(eagerly))
    track = eager.track("agent1")
    sideways = np.linalg.norm(np.diff(track.velocity_mps, axis=0), axis=1) / 0.2
    assert 0.065 < sideways.max() <= 0.07
