"""Tables and figures of studies, against hand-made runs."""

import csv
import json
import re
import warnings
from dataclasses import replace

import numpy as np
import pytest
from made_up_runs import AGENTS, Here, made_up, plan
from matplotlib.text import Text
from tiny import TINY

import gridslam as gs
from gridslam.cli.study import _table
from gridslam.drawing.map_figure import encoded
from gridslam.errors import InputError
from gridslam.evaluation.bounds import Bound, MapBound
from gridslam.runs.summary import Entry, described
from gridslam.studies.batches import Benchmark, _benchmarks, batches
from gridslam.studies.columns import HEAD, RECORD, RUNS, STEPS, SUMMARY
from gridslam.studies.looks import DOTTED, SPARSE, STYLES
from gridslam.studies.plots import (
    draw_cdf,
    draw_consistency,
    draw_errors,
    draw_hidden,
    draw_mospa,
    draw_rays,
    draw_study,
    draw_surfaces,
)
from gridslam.studies.spread import standard_error
from gridslam.studies.study import Outcome, Study, Variant, run_study
from gridslam.studies.tables import step_rows, summary_rows, write_tables
from gridslam.world.scene import Scene

MAPPED = ("surface_ospa_m", "image_ospa_m", "surfaces")


@pytest.fixture(scope="module")
def scene():
    return Scene.from_toml(TINY, "tiny")


def test_tables_add_up(scene, tmp_path):
    outcome = run_study(plan(scene), tmp_path / "s", Here())
    found = batches(outcome)
    assert [(batch.agent, batch.runs, batch.diverged) for batch in found] == [(name, 4, 1) for name in AGENTS]
    first = found[0]
    np.testing.assert_allclose(first.rmse("position_error_m"), 0.02 * np.sqrt((1 + 4 + 9 + 16) / 4))
    np.testing.assert_allclose(first.quantiles("position_error_m"), [[0.026] * 3, [0.074] * 3])
    np.testing.assert_allclose(first.rmse("surface_error_m"), 0.1)  # of the runs that have it
    inherited = found[1].benchmark
    assert (inherited.surface_since == 0).all()
    assert inherited.unknown.surface_m.shape[1] == len(inherited.surface_since) == 4
    assert (inherited.mospa_at_bounds_m < 5).all()
    (row, _) = summary_rows(found)
    assert row["nees_in_band"] == 1
    assert row["ray_excess"] == 1
    assert row["image_ospa_m"] == 0.25
    assert np.isnan(row["surface_gospa_m"]), "of runs that were done before it was counted"
    scores = [record["agents"][found[0].agent]["scores"] for record in found[0].records]
    for own, value in zip(scores, (2.5, 0.5, None, 0.0), strict=True):  # None: found nothing by features
        own["surface_gospa_m"] = value
    assert summary_rows(found)[0]["surface_gospa_m"] == pytest.approx(1.0)
    for record in found[0].records:  # as of a method that maps no surfaces
        record["agents"][found[0].agent]["scores"]["surfaces_detected"] = None
    bare = summary_rows(found)[0]
    assert np.isnan([bare["image_ospa_m"], bare["surface_ospa_m"]]).all()
    assert bare["ray_excess"] == 1
    found[0].steps["rays"] = 0 * found[0].steps["rays"]
    assert np.isnan([summary_rows(found)[0][f"{what}ray_excess"] for what in ("", "likely_")]).all()
    found[0].steps["surfaces"][:] = 0  # as of features, from which surfaces follow at the end
    for record in found[0].records:
        record["agents"][found[0].agent]["scores"] |= {"surfaces_detected": 2, "surface_ospa_m": 0.04}
    late = summary_rows(found)[0]
    assert (late["surface_ospa_m"], np.isnan(late["image_ospa_m"])) == (pytest.approx(0.04), True)
    assert row["likely_ray_excess"] >= 1
    assert row["position_settled_rmse_m"] == pytest.approx(0.02 * np.sqrt(7.5))
    assert row["position_to_unknown_map_bound"] < row["position_to_known_map_bound"]
    assert len(step_rows(found)) == 3 + 2
    assert step_rows(found)[0]["heading_p90_deg"] == pytest.approx(np.degrees(0.01))
    told = dict[str, set[str]]()
    for path in write_tables(tmp_path, found):
        with path.open(newline="") as file:
            rows = list(csv.DictReader(file))
        told[path.stem] = set(rows[0])
        assert {row["agent"] for row in rows} == set(AGENTS)
        assert all(len(row) == len(rows[0]) and None not in row for row in rows)
    for name, columns in (("steps", STEPS), ("summary", SUMMARY)):
        assert told[name] == {one.name for one in columns}, "what is written is what is described"
    assert told["runs"] - {one.name for one in RUNS} == set()
    assert {f"position_{of}_map_bound_m" for of in ("known", "unknown")} <= told["steps"]
    assert not told["steps"] & {"position_bound_m", "heading_bound_deg", "mospa_bound_m"}, "run.json's: known"
    assert not (told["runs"] | told["steps"]) & {name for name in told["summary"] if "rmse" in name}
    with (tmp_path / "runs.csv").open(newline="") as file:
        first, *_ = csv.DictReader(file)
    assert (first["seed"], first["map_auc"], first["reflection_mae"]) == ("0", "", "0.25")


def test_results_are_what_is_described(scene, tmp_path):
    """The first line of study.jsonl, that of a run of agents in turn and that of one of all at once."""
    exchange = gs.Scene.load("exchange").model_dump(exclude_none=True)
    brief = {**exchange, "agents": [{**agent, "steps": 3} for agent in exchange["agents"][:2]]}
    brief = gs.Scene.checked({**brief, "filter": {**exchange["filter"], "particles": 100}}, "exchange")
    lines = []
    for one, method in ((scene, "grid"), (brief, "network")):
        varied = (("filter.births", (0.05,)),)
        run_study(Study((one,), (method,), (1,), varied), tmp_path / method, InThisProcess())
        lines += map(json.loads, (tmp_path / method / "study.jsonl").read_text().splitlines())
    head, record, _, other = lines
    found = set()
    for content, entries in ((head, HEAD), (record, RECORD), (other, RECORD)):
        for key, value, one in described(content, entries):
            assert isinstance(one, Entry), key
            assert value is None or one.fits(value), key
            found.add(one)
    assert found == {*HEAD, *RECORD}


class InThisProcess:
    """Workers that do what they are told, one after the other."""

    def run(self, work, tasks):
        yield from enumerate(map(work, tasks))


def test_standard_errors_over_seeds_and_differences_on_the_same_ones(scene, tmp_path):
    """Of a root mean square to first order; what two methods have in common cancels in their difference."""
    outcome = run_study(plan(scene, agents=("agent1",), methods=("grid", "va", "adaptive")), tmp_path, Here())
    first, same, twice = batches(outcome)
    twice.steps["position_error_m"] *= 2
    rows = summary_rows([first, same, twice])
    error, less, its = (
        [row[f"position_{name}_m"] for row in rows]
        for name in ("settled_standard_error", "less_first", "less_first_standard_error")
    )
    squares = 0.02**2 * np.array([1.0, 4.0, 9.0, 16.0])
    root = np.sqrt(squares.mean())
    want = squares.std(ddof=1) / np.sqrt(4) / (2 * root)
    np.testing.assert_allclose(error, [want, want, 2 * want])
    np.testing.assert_allclose(less, [np.nan, 0, root])
    np.testing.assert_allclose(its, [np.nan, 0, want], atol=1e-15)
    assert rows[0]["heading_settled_standard_error_deg"] == pytest.approx(0, abs=1e-12)
    assert rows[0]["position_settled_median_nees"] == 2
    rng = np.random.default_rng(5)
    drawn = rng.chisquare(2, (4000, 20))
    spread = np.mean([standard_error(one) for one in drawn])
    assert spread == pytest.approx(np.sqrt(drawn.mean(1)).std(), rel=0.08)
    (alone,) = summary_rows(batches(run_study(plan(scene, 1, agents=("agent1",)), tmp_path / "1", Here())))
    assert np.isnan(alone["position_settled_standard_error_m"])


def test_the_printed_table_has_standard_errors_no_wider_than_before(scene, tmp_path, capsys):
    _table(summary_rows(batches(run_study(plan(scene, agents=("agent1",)), tmp_path, Here()))))
    shown = capsys.readouterr().out
    assert re.search(r"5\.48\+-1\.20, \d+\.\d\dx", shown)
    assert "standard error over seeds" in shown
    assert max(map(len, shown[: shown.index("from step 50 on")].splitlines())) <= 120


def test_a_method_without_paths_or_surfaces_is_left_out_of_their_figures(scene, tmp_path):
    """It was drawn as one with 0 paths, and stood in the surfaces' legend without a line."""
    outcome = run_study(plan(scene, 2, agents=("agent1",), methods=("grid", "va")), tmp_path / "s", Here())
    whole, bare = batches(outcome)
    for name in ("rays", "ray_belief"):
        bare.steps[name][:] = 0
    for record in bare.records:
        record["agents"]["agent1"]["scores"]["surfaces_detected"] = None
    for draw in (draw_rays, draw_surfaces):
        figure = draw([whole, bare])
        labels = {line.get_label() for axes in figure.axes for line in axes.lines}
        assert any(label.startswith("grid") for label in labels), draw
        assert not any(label.startswith("va") for label in labels), draw
    assert draw_rays([bare]) is None


def test_heading_that_nothing_tells_of_is_left_out_as_in_runs(scene, tmp_path):
    whole = scene.model_dump(exclude_none=True)
    blind = Scene.checked(whole | {"radio": whole["radio"] | {"measures": ["distance", "aod"]}}, "blind")
    found = batches(run_study(plan(blind, 2, agents=("agent1",)), tmp_path / "s", Here()))
    (row,) = summary_rows(found)
    assert np.isnan([value for name, value in row.items() if name.startswith("heading")]).all()
    assert np.isnan([value for name, value in step_rows(found)[0].items() if "heading" in name]).all()
    assert row["position_settled_rmse_m"] > 0
    labels = [axes.get_ylabel() for draw in (draw_errors, draw_consistency) for axes in draw(found).axes]
    assert labels == ["position RMSE (cm)", "mean NEES of position"]
    assert len(draw_cdf(found).axes) == 1


def test_figures_say_in_their_legends_what_each_line_is(scene, tmp_path):
    found = batches(run_study(plan(scene, 2, agents=("agent1",)), tmp_path / "s", Here()))
    for draw, titles in (
        (draw_errors, {"known-map bound", "unknown-map bound", "80 % of the runs"}),
        (draw_mospa, {"mean of the walls' bounds", "surfaces that are there", "80 % of the runs"}),
        (draw_rays, {"true paths", "sum of the paths' beliefs"}),
        (draw_surfaces, {"mapping error bound", "share of runs that have it (right axes)"}),
        (draw_consistency, {"mean of a consistent filter", "95 % band of a consistent filter"}),
    ):
        figure = draw(found)
        (legend,) = figure.legends
        assert titles <= {text.get_text() for text in legend.get_texts()}, draw
        labels = [axes.get_xlabel() + axes.get_ylabel() for axes in figure.axes]
        assert not re.search("dashed|dotted|thin|grey", " ".join(labels))
    assert not {style for style in STYLES if style in (DOTTED, SPARSE)}, "no method looks like a bound"


def test_drawing_that_is_stopped_leaves_the_figures_of_before(scene, tmp_path, monkeypatch):
    found = batches(run_study(plan(scene, 1, agents=("agent1",)), tmp_path / "s", Here()))
    drawn = []

    def content(figure, form):
        drawn.append(figure)
        if len(drawn) == 8:
            raise KeyboardInterrupt
        return b"first" if len(drawn) < 7 else b"second"

    monkeypatch.setattr("gridslam.studies.plots.encoded", content)
    written = draw_study(tmp_path / "s", found)
    assert len(written) == 6
    with pytest.raises(KeyboardInterrupt):
        draw_study(tmp_path / "s", found)
    assert {path.read_bytes() for path in (tmp_path / "s" / "figures").iterdir()} == {b"first"}


def test_figures_call_surfaces_as_the_scene_calls_their_walls(scene, tmp_path):
    data = scene.model_dump(exclude_none=True)
    data["walls"][0]["name"] = "the hall of the castle by the sea"
    named = Scene.checked(data, "tiny")
    for own, begins in ((named, "the hall of the castle\nby the sea, side "), (scene, "surface ")):
        found = batches(run_study(plan(own, 1, agents=("agent1",)), tmp_path / begins[:3], Here()))
        titles = [axes.get_title() for axes in draw_surfaces(found).axes if axes.get_title()]
        assert titles
        assert all(title.startswith(begins) for title in titles)


def test_errors_beyond_the_axes_are_told_in_the_figure(scene, tmp_path):
    found = batches(run_study(plan(scene, 2, agents=("agent1",)), tmp_path / "s", Here()))
    assert not [text for axes in draw_errors(found).axes for text in axes.texts]
    found[0].steps["position_error_m"][:, 0] = 0.7  # as of a start that isn't known
    position, heading = draw_errors(found).axes
    assert [text.get_text() for text in position.texts] == ["cut off: up to 70, at step 0"]
    assert position.get_ylim()[1] < 10, "steps after it can be told apart"
    assert not heading.texts


@pytest.mark.parametrize(
    "spoil",
    [
        lambda run: run["agents"].pop("agent2"),
        lambda run: run["agents"]["agent1"]["steps"].pop("rays"),
        lambda run: run["agents"]["agent1"]["steps"]["surfaces"].append(3),
        lambda run: run["agents"]["agent1"]["steps"]["surfaces"].__setitem__(0, "many"),
        lambda run: run["agents"]["agent1"].update(cost=None),
        lambda run: run["agents"]["agent1"]["scores"].pop("map"),
    ],
)
def test_run_that_was_tampered_with_is_named(scene, spoil):
    study = plan(scene, 2)
    records = [made_up(job) for job in study.jobs()]
    spoil(records[1])
    with pytest.raises(InputError, match=r"damaged run \(seed 1 of agent[12]\)"):
        batches(Outcome(study, records))


def test_bound_of_the_map_counts_surfaces_there_and_unknowable_ones_as_the_cutoff():
    blank = np.zeros(3)
    surface_m = np.array([[1.0, np.inf, np.inf], [0.5, 9.0, np.inf], [0.3, 0.6, 0.9]])
    unknown = MapBound(blank, blank, np.arange(3), np.zeros((3, 2)), surface_m, np.zeros((6, 6)))
    rays = np.zeros((2, 3), int)
    mark = Benchmark(
        Bound(blank, blank),
        unknown,
        rays,
        rays,
        np.array([0, 0, 2]),
        np.full(3, -1),
        ("A", "B"),
        np.ones((2, 3), bool),
    )
    assert mark.surfaces.tolist() == [2, 2, 3]
    np.testing.assert_allclose(mark.mospa_at_bounds_m, [3.0, 2.75, 0.6])
    bent = replace(mark, curve=np.array([-1, 7, 7]))  # two facets of one wall
    assert bent.surfaces.tolist() == [2, 2, 2]
    np.testing.assert_allclose(bent.mospa_at_bounds_m, [3.0, 2.75, 0.45])


@pytest.mark.slow
def test_errors_while_hidden_are_drawn_beside_what_is_claimed_of_methods_on_samples():
    screen = Scene.load("screen")
    short = screen.model_dump(exclude_none=True)
    short["agents"][0]["steps"] = 100
    scene = Scene.checked(short, "short")
    study = Study((scene,), ("hybrid", "los", "grid"), (0, 1))
    jobs = study.jobs()
    records = [made_up(job, 0.02 if job.method == "hybrid" else 0.5) for job in jobs]
    own = batches(Outcome(study, records))
    hidden = own[0].benchmark.hidden
    assert np.flatnonzero(hidden)[[0, -1]].tolist() == [68, 99]
    (axes,) = draw_hidden(own).axes
    shown = {line.get_label(): line.get_ydata() for line in axes.lines if "hidden" in line.get_label()}
    assert [name.partition(" ")[0] for name in shown] == ["hybrid", "los", "grid"]
    label, error = next(iter(shown.items()))
    np.testing.assert_allclose(error, 100 * 0.02 * np.sqrt(2.5))
    assert label.endswith("hidden 3.16 cm, claimed 3")
    assert draw_hidden([batch for batch in own if batch.method == "grid"]) is None
    everywhere = [replace(b, benchmark=replace(b.benchmark, sight=np.ones((1, 100), bool))) for b in own]
    assert draw_hidden(everywhere) is None


@pytest.mark.slow
def test_a_study_of_a_method_that_maps_no_surfaces_draws_without_a_warning():
    data = Scene.load("scatter").model_dump(exclude_none=True)
    data["agents"][0]["steps"], data["scatterers"] = 20, data["scatterers"][:1]
    study = Study((Scene.checked(data, "short"),), ("hybrid",), (0, 1))
    own = batches(Outcome(study, [made_up(job, 0.02) for job in study.jobs()]))
    none = {name: np.full_like(v, np.nan) for name, v in own[0].steps.items() if name in MAPPED}
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        bare = replace(own[0], steps=own[0].steps | none)
        encoded(draw_mospa([own[0], bare]))
        assert draw_mospa([bare]) is None, "empty panels"
        assert draw_surfaces([bare]) is None, "bounds alone"


@pytest.mark.slow
def test_figures_of_several_settings_are_drawn_side_by_side(scene, tmp_path, monkeypatch):
    monkeypatch.setattr("gridslam.studies.plots.MOST_SURFACES", 2)  # every panel costs
    study = plan(scene, 2, settings=(("radio.snr_at_1m_db", (20.0, 30.0)),), agents=("agent1",))
    outcome = run_study(study, tmp_path / "s", Here())
    drawn = []

    def noted(figure, form):
        content = encoded(figure, form)
        sizes = {text.get_fontsize() for text in figure.findobj(Text) if text.get_text()}
        drawn.append((figure.get_tightbbox(), max(sizes)))
        return content

    monkeypatch.setattr("gridslam.studies.plots.encoded", noted)
    narrow = draw_study(tmp_path / "s", batches(outcome), "pdf", 3.5)
    for path, (box, largest) in zip(narrow, drawn, strict=True):
        (wide,) = re.findall(rb"/MediaBox \[ *0 0 ([\d.]+)", path.read_bytes())
        assert float(wide) == pytest.approx(72 * 3.5, abs=0.5), path.name
        assert 0 <= box.x0 < box.x1 <= 3.5, path.name
        assert largest < 1.3 * 7, "letters of a narrow figure"
    assert [path.suffix for path in narrow] == 6 * [".pdf"]
    assert all(path.stat().st_size > 10_000 for path in narrow)
    assert all(path.read_bytes().startswith(b"%PDF") for path in narrow)
    axes = draw_errors(batches(outcome)).axes[0]
    assert axes.get_yscale() == "linear"
    styles = {(line.get_color(), line.get_linestyle()) for line in axes.lines if "runs" in line.get_label()}
    assert len({color for color, _ in styles}) == len({style for _, style in styles}) == 2


def test_no_bounds_are_drawn_where_scatterers_tell_samples_more_than_walls_do():
    data = Scene.load("scatter").model_dump(exclude_none=True)
    data["agents"][0]["steps"] = 2
    data["scatterers"] = data["scatterers"][:1]
    scattered = Variant(Scene.checked(data, "scatter").to_toml(), "scatter", ())
    for takes, bounded in (("signal", False), ("paths", True)):
        mark = _benchmarks(scattered, takes, ["agent1"])["agent1"]
        for bound in (mark.known, mark.unknown):
            assert np.isfinite(bound.position_m).all() == bounded
            assert np.isfinite(bound.heading_rad).any() == bounded
