"""Maps and runs show themselves: in one line, as a figure, in a notebook, in a paper."""

import base64
import re
import tracemalloc
from dataclasses import replace

import matplotlib.image
import numpy as np
import pytest
from matplotlib.text import Text
from tiny import TINY

import gridslam as gs
from gridslam.drawing.anchor_labels import side_of
from gridslam.drawing.map_figure import FORMATS, PURPLE, draw_map, encoded

COLUMN_IN = 3.5
"""Width of one of a journal's two columns."""
BEGINNINGS = {"png": b"\x89PNG", "pdf": b"%PDF", "svg": b"<?xml"}


@pytest.fixture(scope="module")
def run():
    scene = gs.Scene.from_toml(TINY, "tiny")
    return gs.map_scene(scene, gs.simulate(scene, "agent1", 1), seed=1, particles=100)


def one_line(shown):
    assert shown.isprintable()
    assert len(shown) < 200
    return shown


def test_what_users_hold_is_told_in_one_line(run):
    last = run.estimates[-1]
    assert one_line(repr(run)).startswith("<Run of agent1 in tiny by grid, seed 1: 3 steps, ")
    assert "interrupted" not in repr(run)
    assert "interrupted" in repr(replace(run, interrupted=True))
    assert "48 x 38 cells of 0.2 m" in one_line(repr(run.map))
    assert f"at step 2: {last.position_m[0]:.2f}, {last.position_m[1]:.2f} m" in one_line(repr(last))
    assert f"{int(last.detected.sum())} surfaces" in repr(last)
    assert "anchors A, B, true track known" in one_line(repr(gs.simulate(run.scene, "agent1", 1)))


def test_a_run_counts_the_steps_at_which_it_was_unwell_in_its_line(run):
    estimates = list(run.estimates)
    sick = replace(estimates[0].health, ok=False, why="nothing fits")
    for number, words in ((0, "unwell at 1 step>"), (2, "unwell at 2 steps>")):
        estimates[number] = replace(estimates[number], health=sick)
        assert one_line(repr(replace(run, estimates=estimates))).endswith(f", {words}")
    cut = one_line(repr(replace(run, estimates=estimates, interrupted=True)))
    assert cut.endswith(", unwell at 2 steps, interrupted>")
    assert "unwell" not in repr(run)
    long = replace(run, estimates=estimates * 4000, surfaces=run.surfaces.take([0] * 1000))
    assert "12000 steps, 1000 surfaces, unwell at 8000 steps>" in one_line(repr(long))


def test_unwell_filter_says_so_in_its_line(run):
    sick = replace(run.estimates[0].health, ok=False, why="nothing fits")
    assert repr(replace(run.estimates[0], health=sick)).endswith("nothing fits>")


@pytest.mark.slow
@pytest.mark.parametrize("shown", ["run", "map"])
def test_notebooks_get_a_picture_that_loads_nothing(run, shown, tmp_path):
    page = (run if shown == "run" else run.map)._repr_html_()
    (code,) = re.findall(r'src="data:image/png;base64,([^"]+)"', page)
    (tmp_path / "a.png").write_bytes(base64.b64decode(code))
    picture = matplotlib.image.imread(tmp_path / "a.png")
    assert min(picture.shape[:2]) > 100
    assert picture[..., :3].std() > 0.01, "not blank"
    assert "http" not in page


@pytest.mark.slow
def test_plot_of_a_method_without_cells_speaks_of_none(run):
    """Its cells aren't unexplored: there are none."""
    measurements = gs.simulate(run.scene, "agent1", 1)
    lines = gs.map_scene(run.scene, measurements, method="adaptive", seed=1, particles=100).plot()
    words = {text.get_text() for text in lines.legends[0].get_texts()}
    assert "surfaces found, where they were hit" in words
    assert "surfaces found" not in words
    assert not words & {"free", "unexplored", "occupied"}
    assert len(lines.axes[0].images) == 0


def test_plot_shows_what_is_known(run):
    truth = gs.ground_truth(run.scene, "agent1")
    labels = [{text.get_text() for text in run.plot(t).legends[0].get_texts()} for t in (None, truth)]
    false = {"found where none is", "found where none is, not in cells"}
    assert labels[1] - labels[0] - false == {"true track"}
    assert {"estimated track", "true walls", "surfaces found", "occupied"} <= labels[0]
    assert "true walls" not in {text.get_text() for text in draw_map(run.map).legends[0].get_texts()}


def test_plot_takes_the_width_of_a_column_with_letters_that_fit(run):
    page, column = run.plot(), run.plot(width_cm=8.8)
    assert page.get_figwidth() == pytest.approx(7.2)
    assert column.get_figwidth() == pytest.approx(8.8 / 2.54)
    sizes = [{text.get_fontsize() for text in f.findobj(Text) if text.get_text()} for f in (page, column)]
    assert max(sizes[1]) < max(sizes[0])
    (legend,) = column.legends
    assert legend.get_window_extent().width <= column.bbox.width


@pytest.mark.parametrize("width", [0, 4.9, 51, float("nan"), "8.8 cm"])
def test_plot_refuses_a_width_that_none_can_be_drawn_in(run, width):
    with pytest.raises(gs.InputError, match=r"width_cm: found .*; allowed: 5 to 50 cm"):
        run.plot(width_cm=width)


def test_true_walls_lie_under_the_cells_that_cover_them(run):
    (axes,) = run.plot().axes
    order = {item.get_label(): item.get_zorder() for item in axes.collections}
    free, occupied = (image.get_zorder() for image in axes.images)
    assert free < order["true walls"] < occupied < order["surfaces found"]
    width = {item.get_label(): item.get_linewidth()[0] for item in axes.collections}
    assert width["true walls"] >= 1.5 * width["surfaces found"], "seen on both sides of what was found"
    assert np.ma.masked_invalid(axes.images[1].get_array()).count() == run.map.occupied.sum()


def test_false_surfaces_are_drawn_each_and_told_from_others(run):
    """One that no cell bears out, too: it stands in the table."""
    table = run.map.surfaces
    false = np.arange(len(table)) == 0
    for never_hit, label in ((False, "found where none is"), (True, "found where none is, not in cells")):
        extent = np.where(never_hit & false[:, None], np.nan, table.extent_m)
        grid = replace(run.map, surfaces=replace(table, extent_m=extent))
        (axes,) = draw_map(grid, run.scene, false=false).axes
        pale = {lines.get_label() for lines in axes.collections if (lines.get_alpha() or 1) < 0.5}
        assert (label in pale) is never_hit
        own = {item.get_label(): item for item in axes.collections}
        assert label in own
        assert own[label].get_color().tolist() != own["surfaces found"].get_color().tolist()
        angle, offset = table.line[0]
        ends = np.concatenate(own[label].get_segments())
        np.testing.assert_allclose(ends @ [np.cos(angle), np.sin(angle)], offset, atol=1e-9)
    assert not any("none is" in item.get_label() for item in run.plot().axes[0].collections)


def test_a_surface_that_was_hit_at_one_place_has_a_dot(run):
    """A line of no length is none on paper, though the table counts it and the legend speaks of it."""
    table = run.map.surfaces
    false = np.arange(len(table)) == 0
    extent = np.where(false[:, None], table.extent_m.mean(1, keepdims=True), table.extent_m)
    grid = replace(run.map, surfaces=replace(table, extent_m=extent))
    (axes,) = draw_map(grid, run.scene, false=false).axes
    (pink,) = (item for item in axes.collections if "none is" in item.get_label())
    dots = [line for line in axes.lines if line.get_marker() == "o" and len(line.get_xdata())]
    own = [line for line in dots if line.get_color() == PURPLE]
    np.testing.assert_allclose(own[0].get_xydata(), [pink.get_segments()[0].mean(0)])


def test_false_surfaces_are_those_at_no_wall_whoever_heard_it(run):
    """Of a map that went on, a wall that only an earlier agent heard isn't false."""
    truth = gs.ground_truth(run.scene, "agent1")

    def false(one, truth):
        drawn = one.plot(truth).axes[0].collections
        return sum(len(item.get_segments()) for item in drawn if "none is" in item.get_label())

    assert false(run, truth.first(0)) == false(run, truth) == run.score(truth)["surfaces_false"] == 1


@pytest.mark.slow
@pytest.mark.parametrize("width", [COLUMN_IN, 7.2])
def test_figures_have_the_width_that_was_asked_for_and_nothing_sticks_out(run, width):
    false = np.ones(len(run.map.surfaces), bool)
    figure = draw_map(run.map, run.scene, run.trajectory, run.trajectory, width=width, false=false)
    (box,) = re.findall(rb"/MediaBox \[ *0 0 ([\d.]+)", encoded(figure, "pdf"))
    assert float(box) == pytest.approx(72 * width, abs=0.5)
    drawn = figure.get_tightbbox()
    assert 0 <= drawn.x0 < drawn.x1 <= width


@pytest.mark.slow
@pytest.mark.parametrize("form", FORMATS)
def test_figures_for_papers_are_of_their_format_and_repeat(run, form):
    figure = draw_map(run.map, run.scene, width=COLUMN_IN)
    assert figure.get_figwidth() == COLUMN_IN
    content = encoded(figure, form)
    assert content.startswith(BEGINNINGS[form])
    assert encoded(draw_map(run.map, run.scene, width=COLUMN_IN), form) == content


def test_names_of_anchors_stand_clear_of_walls_and_inside():
    """In `hall` a pillar stands up right of A, and was covered by its name in narrow figures."""
    hall = gs.Scene.load("hall")
    shown = np.array([[-12.6, -5.6], [12.6, 5.6]])
    a, b = hall.anchor_positions
    assert side_of(a, hall, shown).tolist() == [-1, 1]
    assert side_of(b, hall, shown).tolist() == [1, -1]
    bare = hall.model_copy(update={"walls": ()})
    assert side_of(a, bare, shown).tolist() == [1, 1]
    assert side_of(np.array([12.5, 5.5]), bare, shown).tolist() == [-1, -1]


@pytest.mark.slow
def test_pictures_of_many_cells_take_little_beside_the_map_itself():
    rng, shape = np.random.default_rng(1), (1000, 1000)
    grid = replace(gs.Map.blank((0, 0), 0.1, shape, 0.1), observed=rng.random(shape) < 0.5)
    grid = replace(grid, evidence=rng.normal(-1, 3, shape))
    encoded(draw_map(gs.Map.blank((0, 0), 0.1, (4, 4), 0.1)))  # fonts, and whatever is made once
    tracemalloc.start()
    try:
        encoded(draw_map(grid))
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak / grid.observed.size < 60, "bytes a cell"


def test_true_tracks_are_broken_at_holes(run):
    """No straight line says where the agent went unseen."""
    track = replace(run.trajectory, holes_s=np.array([run.trajectory.time_s[[0, 2]]]))
    axes = draw_map(run.map, run.scene, run.trajectory, track).axes[0]
    lines = {line.get_label(): line.get_xydata() for line in axes.lines}
    assert np.isnan(lines["true track"][1:-1]).all()
    assert np.isfinite(lines["true track"][[0, -1]]).all()
    assert np.isfinite(lines["estimated track"]).all()
