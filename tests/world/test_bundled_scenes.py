"""Bundled scenes: what each promises to make hard, checked on its true paths."""

import re

import numpy as np
import pytest

from gridslam.simulation.image_source import true_paths
from gridslam.world.radio import SPEED_OF_LIGHT
from gridslam.world.scene import Scene
from gridslam.world.scene_files import BUNDLED, bundled_scenes


@pytest.mark.slow
def test_bundled_scenes_cite_their_source_and_say_what_is_hard():
    assert bundled_scenes() == [
        "alcove",
        "annex",
        "building",
        "canyon",
        "ceiling",
        "chamber",
        "exchange",
        "facade",
        "hall",
        "overlap",
        "pillars",
        "room",
        "scatter",
        "screen",
        "seminar",
    ]
    for name in bundled_scenes():
        head = re.split(r"^(?!#)", (BUNDLED / f"{name}.toml").read_text(), maxsplit=1, flags=re.M)[0]
        assert re.search(r"\[([A-Z]\w+\d{4}\w+|LiangDirect|HybridSlam)\]", head)
        assert "hard about it" in head
        scene = Scene.load(name)
        assert scene.name == name
        assert scene.description
        assert Scene.from_toml(scene.to_toml()) == scene


def loud_bounces(name, agent, above):
    """Surface (by wall entry) of every single and double bounce stronger than `above`, per step."""
    scene = Scene.load(name)
    paths, walls = true_paths(scene, agent), scene.segments()
    entry = np.append(walls.wall, -1)[paths.segment]
    loud = paths.amplitude > above
    return scene, paths, entry, loud


def steps_of(paths, rows):
    return np.unique(paths.step[rows])


def test_room_hears_every_wall_at_every_step():
    scene, paths, _, loud = loud_bounces("room", "agent1", 2.0)
    surface = scene.segments().surface[paths.segment[:, 0]]
    assert len(scene.track("agent1")) == 150
    for number in range(4):
        rows = loud & (paths.bounces == 1) & (surface == number)
        assert len(steps_of(paths, rows)) == 150


def test_alcove_floor_is_known_by_double_bounces_alone_until_step_126():
    _, paths, entry, loud = loud_bounces("alcove", "agent1", 2.45)
    floor = (entry == 2).any(axis=1)
    single = steps_of(paths, (paths.bounces == 1) & floor)  # however weak
    assert single[0] == 126
    double = steps_of(paths, (paths.bounces == 2) & floor & loud)
    assert (double < 126).sum() >= 120
    for wall in range(5):
        rows = loud & (paths.bounces == 1) & (entry[:, 0] == wall)
        assert len(steps_of(paths, rows)) >= 50
        assert len(steps_of(paths, rows & (paths.step >= 230))) >= 10  # seen towards the end
    assert paths.step.max() == 306


@pytest.mark.slow
@pytest.mark.parametrize("agent", ["agent1", "agent2"])
def test_canyon_is_heard_well_enough_to_map(agent):
    scene, paths, entry, loud = loud_bounces("canyon", agent, 3.0)
    steps, sight = len(scene.track(agent)), (paths.bounces == 0) & loud
    seen = np.zeros((steps, 3), bool)
    seen[paths.step[sight], paths.anchor[sight]] = True
    assert steps >= 300
    assert seen.any(axis=1).all()
    assert (seen.sum(axis=1) >= 2).mean() > 0.9
    single = (paths.bounces == 1) & loud
    walls = range(3) if agent == "agent1" else (2, 3, 4, 5)
    for wall in walls:
        assert len(steps_of(paths, single & (entry[:, 0] == wall))) >= 50
    if agent == "agent2":  # the curved front, facet by facet
        facets = paths.segment[single & (entry[:, 0] == 3), 0]
        assert (np.unique(facets, return_counts=True)[1] >= 10).sum() >= 10


def test_canyon_window_lies_in_the_line_of_its_wall():
    walls = Scene.load("canyon").segments()
    window = walls.wall == 1
    assert len(np.unique(walls.surface[walls.wall <= 2])) == 1
    assert walls.reflection[window] == pytest.approx(0.3)


def test_canyon_tracks_overlap_only_in_part():
    scene = Scene.load("canyon")
    one, two = (scene.track(name).position_m for name in ("agent1", "agent2"))
    near = (np.linalg.norm(two[:, None] - one[None], axis=-1) < 1.0).any(axis=1).mean()
    assert 0.1 < near < 0.6


@pytest.mark.slow
def test_hall_shows_one_anchor_for_100_steps_then_none_for_40():
    scene, paths, _, loud = loud_bounces("hall", "agent1", 3.0)
    assert len(scene.track("agent1")) == 450
    sight = np.zeros((450, 2), bool)
    rows = paths.bounces == 0
    sight[paths.step[rows], paths.anchor[rows]] = True
    assert sight[:100, 0].all()
    assert not sight[:100, 1].any()
    assert not sight[100:140].any()
    assert sight[140:].any(axis=1).all()
    assert sight[140:, 1].mean() > 0.9  # the other anchor, at last
    single = np.zeros((450, 2), int)
    np.add.at(single, (paths.step, paths.anchor), loud & (paths.bounces == 1))
    assert (single[100:140] >= 1).all()  # what is left in the dark: at least a single bounce from each
    assert (single[100:140].sum(axis=1) >= 4).all()


@pytest.mark.slow
def test_hall_pillars_and_shelves_are_heard_at_least_for_a_while():
    _, paths, entry, loud = loud_bounces("hall", "agent1", 2.5)
    for wall in range(1, 5):
        rows = loud & (paths.bounces == 1) & (entry[:, 0] == wall)
        assert len(steps_of(paths, rows)) >= 5, wall


@pytest.mark.slow
def test_seminar_is_heard_by_distances_of_sight_and_single_bounces_alone():
    scene, paths, entry, _ = loud_bounces("seminar", "agent1", 0.0)
    assert scene.radio.measures == ("distance",)
    assert len(scene.track("agent1")) == 900
    assert set(paths.bounces) == {0, 1}
    sight = np.zeros((900, 2), bool)
    sight[paths.step[paths.bounces == 0], paths.anchor[paths.bounces == 0]] = True
    assert sight.all()
    images = {(a, s) for a, s in zip(paths.anchor, paths.segment[:, 0], strict=True) if s >= 0}
    assert len(images) == 9
    assert set(entry[paths.bounces == 1, 0]) == {0}


def test_seminar_crosses_the_line_between_its_anchors():
    scene = Scene.load("seminar")
    (ax, ay), (bx, by) = scene.anchor_positions
    x, y = scene.track("agent1").position_m.T
    side = np.sign((bx - ax) * (y - ay) - (by - ay) * (x - ax))
    assert (np.diff(side) != 0).sum() >= 1


@pytest.mark.slow
def test_overlap_has_paths_closer_than_its_resolution_most_of_the_time():
    scene, paths, _, _ = loud_bounces("overlap", "agent1", 0.0)
    waveform = scene.waveform("agent1")
    assert len(scene.track("agent1")) == 679
    assert waveform.shape == (2, 1, 1, 41)
    assert waveform.bandwidth_hz == pytest.approx(4e8)
    assert paths.distance_m.max() < waveform.folding_m
    resolution = SPEED_OF_LIGHT / waveform.bandwidth_hz
    close = [
        (
            np.diff(np.sort(paths.distance_m[(paths.step == step) & (paths.anchor == anchor)])) < resolution
        ).any()
        for step in range(679)
        for anchor in range(2)
    ]
    assert 0.84 < np.mean(close) < 0.88


def test_screen_hides_the_line_of_sight_and_it_alone_in_the_middle():
    scene, paths, entry, _ = loud_bounces("screen", "agent1", 0.0)
    assert len(scene.track("agent1")) == 190
    seen = steps_of(paths, paths.bounces == 0)
    assert np.setdiff1d(np.arange(190), seen).tolist() == list(range(68, 127))
    for wall in (0, 1):
        assert len(steps_of(paths, (paths.bounces == 1) & (entry[:, 0] == wall))) == 190
    assert not (entry == 2).any()
    assert len(steps_of(paths, paths.bounces == 2)) == 190
    assert scene.waveform("agent1").shape == (1, 1, 4, 81)


def test_annex_hides_anchors_from_its_agents():
    """Out of sight for more than a third of the way: anchor A of agent1, B of agent2; the glass is heard."""
    for agent, anchor in (("agent1", 0), ("agent2", 1)):
        scene, paths, _, _ = loud_bounces("annex", agent, 2.0)
        assert len(scene.track(agent)) == 300
        seen = (paths.bounces == 0) & (paths.anchor == anchor)
        assert 100 < len(steps_of(paths, seen)) < 200
    glass = loud_bounces("annex", "agent1", 2.0)[2]
    assert (glass == 2).any()


def test_scatter_hides_the_sight_and_has_more_power_in_scatterers_than_in_it():
    scene = Scene.load("scatter")
    paths = true_paths(scene, "agent1")
    sight = np.isin(np.arange(190), paths.step[paths.bounces == 0])
    assert np.flatnonzero(~sight).tolist() == list(range(68, 127))
    assert not paths.of_walls[paths.bounces > 0].any()
    for step in range(0, 190, 10):
        now = paths.at(step)
        direct = (10 ** (42 / 20) / np.hypot(*(now.points[0, 3] - now.points[0, 0]))) ** 2
        assert (now.amplitude[now.bounces == 1] ** 2).sum() > direct


def test_ceiling_leads_right_under_an_anchor_and_stays_below_them():
    scene, paths, _, _ = loud_bounces("ceiling", "agent1", 2.0)
    steep = np.arcsin(scene.heights("agent1")[paths.anchor] / paths.distance_m)
    sight = paths.bounces == 0
    assert np.degrees(steep[sight].max()) > 85
    assert np.median(np.degrees(steep[sight])) < 30
    assert (steep > 0).all()


@pytest.mark.slow
def test_facade_sends_a_crowd_of_paths_of_one_anchor_where_the_others_are_hidden():
    _, paths, entry, loud = loud_bounces("facade", "agent1", 2.5)
    rows = loud & (paths.anchor == 1) & (paths.bounces == 1) & (entry[:, 0] == 1)
    crowd = np.bincount(paths.step[rows], minlength=220)
    assert crowd.max() >= 20
    assert (crowd >= 8).sum() >= 40
    direct = paths.step[(paths.bounces == 0) & (paths.anchor < 2)]
    assert np.isin(direct, np.flatnonzero(crowd >= 8)).sum() <= 1, "A and B are out of sight there"


def test_pillars_hide_both_anchors_at_once_where_faint_walls_alone_are_heard():
    scene, paths, entry, _ = loud_bounces("pillars", "agent1", 2.5)
    steps = scene.agents[0].steps
    hidden = np.setdiff1d(np.arange(steps), paths.step[paths.bounces == 0])
    np.testing.assert_array_equal(hidden, np.arange(125, 168))
    assert (np.bincount(paths.step[paths.bounces == 0], minlength=steps)[:80] == 2).all()
    quiet = scene.radio.model_copy(update={"snr_at_1m_db": 30.0})
    radio = scene.model_copy(update={"radio": quiet}).signal_model("agent1")
    inside = np.isin(paths.step, hidden)
    chance = radio.detection_probability(paths.amplitude[inside] / np.sqrt(10))
    assert 1 < chance.sum() / len(hidden) < 3, "at 30 dB some two paths a step are heard"
    metal = [n for n, wall in enumerate(scene.walls) if wall.material == "metal"]
    assert np.isin(entry[inside], metal).any(), "the pillars themselves answer, too"
