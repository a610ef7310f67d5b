"""Report and moving picture of a run: whole, offline, harmless, and without walls too."""

import base64
import json
import re
import subprocess
from dataclasses import replace
from html.parser import HTMLParser
from itertools import pairwise
from shutil import which

import numpy as np
import pytest
from map_samples import surfaces
from matplotlib.figure import Figure
from PIL import Image

import gridslam as gs
from gridslam.cli.main import main
from gridslam.errors import InputError
from gridslam.importers.geojson import write_surfaces
from gridslam.maps.map import Map
from gridslam.runs.run_files import read_run, write_run
from gridslam.viewers.animation import animate, film_ending
from gridslam.viewers.plots import _count_surfaces, draw_errors, draw_rays
from gridslam.viewers.report import surface_table, write_report

STEPS = 5
NASTY = '<script>alert("&")</script>'


def scene_of(walls):
    whole = gs.Scene.load("room").model_dump(exclude_none=True)
    agent = {**whole["agents"][0], "steps": STEPS}
    if not walls:
        del whole["walls"], agent["waypoints_m"], agent["steps"]
    return gs.Scene.checked({**whole, "agents": (agent,), "description": NASTY}, "room")


@pytest.fixture(scope="module", params=[True, False], ids=["walls", "no walls"])
def run_folder(request, tmp_path_factory):
    measurements = gs.simulate(scene_of(True), "agent1", 1)
    scene = scene_of(request.param)
    if not request.param:  # as from a file of one's own
        path = tmp_path_factory.mktemp("heard") / "a.csv"
        measurements.to_csv(path)
        measurements = gs.Measurements.from_csv(path, scene.anchor_names)
    run = gs.map_scene(scene, measurements, seed=1)
    score = run.score(gs.ground_truth(scene, "agent1") if request.param else None)
    folder = tmp_path_factory.mktemp("run") / "out"
    write_run(folder, scene, [run], [measurements], [score], {})
    return folder


class Reader(HTMLParser):
    """Collects what a page would load and checks that its elements close."""

    VOID = ("meta", "img", "br", "link", "input")

    def __init__(self):
        super().__init__()
        self.open, self.loads, self.seen, self.text = [], [], [], ""

    def handle_starttag(self, tag, attrs):
        self.seen.append(tag)
        self.loads += [value for name, value in attrs if name in ("src", "href", "srcset", "data")]
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text += data


@pytest.mark.slow
def test_page_holds_all_and_loads_nothing(run_folder):
    (run_folder / "figures").mkdir()  # instead of drawing them all, which is tested elsewhere
    for title in ("map", "reflection", "rays", "errors"):
        Image.new("L", (4, 4)).save(run_folder / "figures" / f"agent1-{title}.png")
    path = write_report(run_folder)
    page = Reader()
    page.feed(path.read_text(encoding="utf-8"))
    page.close()
    assert page.open == []
    kinds = [re.match(r"data:(\w+)/(png|gif|mp4);base64,[\w+/]+=*$", load)[1] for load in page.loads]
    assert len(kinds) == 5
    policy = {"image": "img-src data:", "video": "media-src data:"}  # else browsers don't show them
    assert all(policy[kind] in path.read_text(encoding="utf-8") for kind in kinds)
    (film,) = (run_folder / "figures").glob("agent1-run.*")
    assert any(base64.b64encode(film.read_bytes()).decode() in load for load in page.loads)
    assert "script" not in page.seen
    assert NASTY in page.text
    summary = json.loads((run_folder / "run.json").read_text())["agents"]["agent1"]
    known = summary["position_rmse_m"] is not None
    assert ("position, RMSE" in page.text) == known
    assert ("walls not known" in page.text) == (not known)
    assert "filter.births" in page.text
    assert "{" not in page.text.split("Settings")[-1]  # values as people write them
    assert f"{summary['surfaces_detected']} surfaces" in page.text


@pytest.mark.slow
def test_every_frame_differs_and_the_last_step_is_shown(run_folder, tmp_path):
    run = read_run(run_folder)
    progress = []
    for frames, count in ((100, STEPS), (2, 2)):
        animate(run.scene, run.agents["agent1"], tmp_path / "a.gif", frames, lambda *n: progress.append(n))
        with Image.open(tmp_path / "a.gif") as film:
            assert film.n_frames == count
            pictures = []
            for number in range(count):
                film.seek(number)
                pictures.append(np.asarray(film.convert("L"), dtype=int))
        assert all((a != b).any() for a, b in pairwise(pictures))
    assert progress[: STEPS + 1] == [(1, 5), (2, 5), (3, 5), (4, 5), (5, 5), (1, 2)]
    assert [path.name for path in tmp_path.iterdir()] == ["a.gif"]


@pytest.mark.slow
def test_films_that_cannot_be_written_leave_nothing(run_folder, tmp_path, monkeypatch):
    run = read_run(run_folder)
    monkeypatch.setattr("gridslam.viewers.animation._ffmpeg", lambda: None)
    assert film_ending() == ".gif"
    for name in ("a.mp4", "a.avi", "none/a.gif"):
        with pytest.raises(InputError):
            animate(run.scene, run.agents["agent1"], tmp_path / name, 2)
    monkeypatch.setattr("gridslam.viewers.animation._ffmpeg", lambda: which("false"))
    for name in ("a.mp4", "none/a.mp4"):
        with pytest.raises(InputError):
            animate(run.scene, run.agents["agent1"], tmp_path / name, 2)
    assert list(tmp_path.iterdir()) == []


def test_mp4_shows_the_frames_of_the_gif(run_folder, tmp_path):
    program = pytest.importorskip("imageio_ffmpeg", reason="imageio-ffmpeg isn't installed").get_ffmpeg_exe()
    run = read_run(run_folder)
    assert film_ending() == ".mp4"
    for name in ("a.mp4", "a.gif"):
        width, height = animate(run.scene, run.agents["agent1"], tmp_path / name)
    assert width % 2 == height % 2 == 0
    command = [
        program,
        "-loglevel",
        "error",
        "-i",
        tmp_path / "a.mp4",
        "-f",
        "rawvideo",
        "-pix_fmt",
        "gray",
        "-",
    ]
    raw = subprocess.run(command, capture_output=True, check=True).stdout
    frames = np.frombuffer(raw, np.uint8).reshape(-1, height, width).astype(int)
    with Image.open(tmp_path / "a.gif") as film:
        assert (film.size, film.n_frames) == ((width, height), len(frames)) == ((width, height), STEPS)
        drawn = []
        for number in range(STEPS):
            film.seek(number)
            drawn.append(np.asarray(film.convert("L"), dtype=int))
    apart = [[np.abs(one - other).mean() for other in drawn] for one in frames]
    assert (np.argmin(apart, axis=1) == np.arange(STEPS)).all()
    assert np.diagonal(apart).max() < 3
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.gif", "a.mp4"]


def test_command_refuses_what_is_no_run(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("sys.argv", ["gridslam", "report", str(tmp_path)])
    with pytest.raises(SystemExit) as stop:
        main()
    assert stop.value.code == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["../../secret", "/etc", ".."])
def test_report_follows_no_agents_name_out_of_the_folder(say, tmp_path, name):
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "scene.toml").write_text(gs.Scene.load("room").to_toml())
    (folder / "run.json").write_text(json.dumps({"scene": "room", "agents": {name: {}}}))
    result = say("report", folder)
    assert (result.code, len(result.complaints)) == (2, 1)
    assert f"run.json: agents: found {name!r}" in result.err


def test_surfaces_of_a_run_can_be_drawn_on_a_map(run_folder, tmp_path):
    found = read_run(run_folder).agents["agent1"].map.surfaces
    write_surfaces(tmp_path / "a.geojson", found)
    content = json.loads((tmp_path / "a.geojson").read_text())
    assert len(content["features"]) == len(found)


def test_evo_reads_the_track_and_finds_the_same_error(run_folder):
    pytest.importorskip("evo", reason="evo isn't installed")
    from evo.core import metrics
    from evo.tools.file_interface import read_tum_trajectory_file

    folder = run_folder / "agent1"
    found = read_tum_trajectory_file(str(folder / "trajectory.tum"))
    own = gs.Trajectory.from_tum(folder / "trajectory.tum")
    np.testing.assert_array_equal(found.timestamps, own.time_s)
    np.testing.assert_array_equal(found.positions_xyz[:, :2], own.position_m)
    yaw = found.get_orientations_euler("sxyz")[:, 2]
    np.testing.assert_allclose(np.exp(1j * yaw), np.exp(1j * own.heading_rad), atol=1e-9)
    if (folder / "truth.tum").exists():
        error = metrics.APE(metrics.PoseRelation.translation_part)
        error.process_data((read_tum_trajectory_file(str(folder / "truth.tum")), found))
        summary = json.loads((run_folder / "run.json").read_text())["agents"]["agent1"]
        rmse = error.get_statistic(metrics.StatisticsType.rmse)
        assert rmse == pytest.approx(summary["position_rmse_m"], rel=1e-9)


def test_surfaces_without_a_wall_of_some_length_are_explained():
    lines = [(0.5 * np.pi, 2.0), (0.0, 1.0), (0.0, 3.0)]
    found = replace(surfaces(lines), extent_m=np.array([[-1, -1], [0.5, 3.5], [np.nan, np.nan]]))
    grid = replace(Map.blank((0, 0), 0.1, (40, 40), 0.01), surfaces=found)
    shown = surface_table(grid)
    for words in ("3.00 m", "one place", "not hit yet", "so its length isn&#x27;t known"):
        assert words in shown
    assert "open by its cells" not in shown
    crossed = replace(grid, evidence=np.full((40, 40), -9.0), observed=np.ones((40, 40), bool))
    assert surface_table(crossed).count("open by its cells") == 3, "two of them, and what it means"
    assert "<p>" not in surface_table(replace(grid, surfaces=surfaces([(0.0, 1.0)])))


@pytest.mark.slow
def test_a_report_made_again_replaces_the_earlier_one_and_no_other_page(run_folder):
    page = write_report(run_folder, moving=False)
    first = page.read_bytes()
    assert write_report(run_folder, moving=False).read_bytes() == first
    page.write_text("<html>what somebody wrote</html>")
    with pytest.raises(InputError, match=r"report\.html: found something of this name"):
        write_report(run_folder, moving=False)
    assert write_report(run_folder, moving=False, overwrite=True).read_bytes() == first


def test_paths_of_which_no_amplitude_was_measured_are_not_drawn_by_strength(run_folder):
    run = read_run(run_folder)
    own = run.agents["agent1"]
    nothing = np.full(len(own.measurements.step), np.nan)
    silent = replace(own, measurements=replace(own.measurements, amplitude=nothing))
    for found, by_strength in ((own, True), (silent, False)):
        axes = draw_rays(run.scene, "agent1", found).axes[0]
        (rays,) = (one for one in axes.collections if one.get_label() != "true walls")
        assert (rays.get_array() is not None) == by_strength
        assert ("no amplitude measured" in axes.get_title()) != by_strength


def test_the_panel_of_surfaces_says_what_its_line_is_with_and_without_a_truth(run_folder):
    run = read_run(run_folder)
    axes = draw_errors(run.scene, "agent1", run.agents["agent1"]).axes[-1]
    assert axes.get_ylabel() == "surfaces"
    assert axes.get_legend().get_texts()[0].get_text() == "detected"
    _, curved = Figure().subplots(2)
    _count_surfaces(curved, run.agents["agent1"], [1] * STEPS, True)
    labels = [line.get_label() for line in curved.get_lines()]
    assert labels == ["detected (curved walls: each piece)", "true, hit so far (curved walls once)"]
