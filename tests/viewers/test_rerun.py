"""A run in the Rerun viewer: what was estimated is recorded; no package or no viewer is one clear line."""

import builtins
import socket
import sys
from math import degrees
from shutil import which
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scene_samples import shortened

import gridslam as gs
from gridslam.runs.run_files import read_run
from gridslam.viewers.rerun_target import open_stream
from gridslam.viewers.rerun_view import RunView, ellipse

STEPS, AGENTS = 12, 2


@pytest.fixture
def no_package(monkeypatch):
    whole = builtins.__import__

    def without(name, *rest, **more):
        if name.split(".")[0] == "rerun":
            raise ModuleNotFoundError(f"No module named {name!r}")
        return whole(name, *rest, **more)

    monkeypatch.setattr(builtins, "__import__", without)
    monkeypatch.delitem(sys.modules, "rerun", raising=False)


@pytest.fixture
def nothing_computed(monkeypatch):
    def start(*_):
        raise AssertionError("began to compute")

    monkeypatch.setattr("gridslam.runtime.start", start)


@pytest.mark.parametrize("words", [("--rerun",), ("--rerun-to", "a.rrd"), ("--rerun-to", "127.0.0.1:1")])
def test_without_the_package_one_line_says_what_to_install(
    say, short_room, no_package, nothing_computed, tmp_path, words
):
    result = say("run", short_room, "-o", "out", *words)
    assert result.code == 2
    assert len(result.complaints) == 1
    assert "pip install 'gridslam[rerun]'" in result.err
    assert [path.name for path in tmp_path.iterdir()] == ["short.toml"]


def test_another_package_of_that_name_is_not_taken_for_it(say, short_room, nothing_computed, monkeypatch):
    monkeypatch.setitem(sys.modules, "rerun", type(sys)("rerun"))
    result = say("run", short_room, "-o", "out", "--rerun")
    assert result.code == 2
    assert len(result.complaints) == 1
    assert "pip install" in result.err


@pytest.fixture(scope="module")
def rerun():
    return pytest.importorskip("rerun", reason="rerun-sdk isn't installed")


def test_target_that_cannot_be_had_is_refused_before_the_run(
    rerun, say, short_room, nothing_computed, tmp_path
):
    (tmp_path / "there.rrd").write_bytes(b"mine")
    with socket.socket() as taken:  # bound, but nobody listens
        taken.bind(("127.0.0.1", 0))
        silent = f"127.0.0.1:{taken.getsockname()[1]}"
        for where, word in (
            (silent, silent),
            ("http://a:1/b", "HOST:PORT"),
            ("a:99999", "HOST:PORT"),
            ("there.rrd", "new name"),
            ("none/a.rrd", "a.rrd"),
        ):
            result = say("run", short_room, "-o", "out", "--rerun-to", where)
            assert (result.code, len(result.complaints)) == (2, 1), result
            assert word in result.err
    assert (tmp_path / "there.rrd").read_bytes() == b"mine"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["short.toml", "there.rrd"]


def test_viewer_that_falls_over_is_one_line(rerun, say, short_room, nothing_computed, monkeypatch):
    monkeypatch.setattr("gridslam.viewers.rerun_target._answers", lambda host, port: False)
    monkeypatch.setattr("gridslam.viewers.rerun_target.sys.executable", which("false"))
    result = say("run", short_room, "-o", "out", "--rerun")
    assert (result.code, len(result.complaints)) == (2, 1)
    assert "--rerun-to" in result.err


def test_recording_of_what_failed_is_not_kept(rerun, tmp_path):
    with pytest.raises(RuntimeError, match="boom"), open_stream(str(tmp_path / "a.rrd")):
        raise RuntimeError("boom")
    assert list(tmp_path.iterdir()) == []


@given(st.floats(-3, 3, allow_subnormal=False), st.floats(0.1, 3), st.floats(0.1, 3))
def test_ellipse_is_as_far_from_the_middle_as_the_covariance_says(turn, long, short):
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    covariance = rotation @ np.diag([long**2, short**2]) @ rotation.T
    around = ellipse(np.array([1.0, -2.0]), covariance) - [1.0, -2.0]
    distance = np.einsum("ni,ij,nj->n", around, np.linalg.inv(covariance), around)
    np.testing.assert_allclose(distance, 9, rtol=1e-6)
    np.testing.assert_allclose(around[0], around[-1], atol=1e-9)


class Recorded:
    """Rows of a recording by entity: (step, {component: values})."""

    def __init__(self, path):
        from rerun.chunk import RrdReader

        self.rows, self.static = {}, {}
        for chunk in RrdReader(path).stream():
            batch = chunk.to_record_batch()
            table = {name: batch[name].to_pylist() for name in batch.column_names if ":" in name}
            steps = batch["step"].to_pylist() if not chunk.is_static else []
            for number in range(chunk.num_rows):
                row = {name.split(":")[-1]: column[number] for name, column in table.items()}
                entity = chunk.entity_path.lstrip("/")
                if chunk.is_static:
                    self.static[entity] = row
                else:
                    self.rows.setdefault(entity, []).append((steps[number], row))
        for rows in self.rows.values():
            rows.sort(key=lambda item: item[0])

    def at(self, entity, step):
        (row,) = [row for number, row in self.rows[entity] if number == step]
        return row

    def curve(self, entity):
        return {step: row["scalars"][0] for step, row in self.rows[entity]}


@pytest.fixture(scope="module")
def session(rerun, tmp_path_factory):
    """A recorded run, its folder, and the folder of the same run unrecorded."""
    from gridslam.cli.main import main

    home = tmp_path_factory.mktemp("rerun")
    scene = home / "short.toml"
    scene.write_text(shortened(gs.Scene.load("room"), STEPS, agents=AGENTS).to_toml())
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("gridslam.viewers.plots.draw_all", lambda folder, run=None: [])
        for words in (
            ["-o", str(home / "plain")],
            ["-o", str(home / "out"), "--rerun-to", str(home / "a.rrd")],
        ):
            patch.setattr("sys.argv", ["gridslam", "run", str(scene), *words])
            with pytest.raises(SystemExit) as stop:
                main()
            assert stop.value.code == 0
    return home


@pytest.fixture(scope="module")
def recorded(session):
    return Recorded(session / "a.rrd")


def test_watching_changes_nothing(session):
    for name in ("agent1/steps.h5", "agent2/steps.h5", "map.h5"):
        assert (session / "plain" / name).read_bytes() == (session / "out" / name).read_bytes()
    assert {path.name for path in session.iterdir()} == {"short.toml", "plain", "out", "a.rrd"}


def test_recording_holds_what_was_estimated_step_by_step(session, recorded):
    run = read_run(session / "out")
    seen = set()
    for number, (name, found) in enumerate(run.agents.items()):
        for now in found.estimates:
            step = number * STEPS + now.step  # the second agent goes on where the first one stopped
            place = recorded.at(f"world/{name}/now/place", step)["positions"]
            np.testing.assert_allclose(np.array(place)[:, :2], [now.position_m], atol=1e-5)
            (arrow,) = recorded.at(f"world/{name}/now/heading", step)["vectors"]
            assert np.arctan2(arrow[1], arrow[0]) == pytest.approx(now.heading_rad, abs=1e-5)
            (ellipse,) = recorded.at(f"world/{name}/now/ellipse", step)["strips"]
            off = np.array(ellipse)[:, :2] - now.position_m
            distance = np.einsum("ni,ij,nj->n", off, np.linalg.inv(now.covariance[:2, :2]), off)
            np.testing.assert_allclose(np.sqrt(distance), 3, atol=0.01)  # float32 of a centimetre at metres
            found_now = now.surfaces.take(now.detected & np.isfinite(now.surfaces.extent_m).all(1))
            strips = recorded.at("world/surfaces", step)["strips"]
            assert len(strips) == len(found_now)
            if len(found_now):
                np.testing.assert_allclose(np.array(strips)[..., :2], found_now.ends_m, atol=1e-5)
                labels = recorded.at("world/surfaces/label", step)["labels"]
                assert [label.split(" ±")[0] for label in labels] == [
                    f"{who}: R {value:.2f}"
                    for who, value in zip(found_now.identity, found_now.reflection, strict=True)
                ]
            ways = recorded.at("world/paths", step)["strips"]
            assert [len(way) for way in ways] == list((~np.isnan(now.paths.points[:, :, 0])).sum(1))
            seen.add((name, step))
    assert len(seen) == AGENTS * STEPS
    assert len(recorded.rows["world/paths"]) == AGENTS * STEPS


def test_errors_are_those_of_the_score(session, recorded):
    run = read_run(session / "out")
    for number, (name, found) in enumerate(run.agents.items()):
        score, steps = run.summary["agents"][name], range(number * STEPS, (number + 1) * STEPS)
        for kind, rmse in (
            ("position_cm", 100 * score["position_rmse_m"]),
            ("heading_deg", score["heading_rmse_deg"]),
        ):
            curve = recorded.curve(f"error/{name}/{kind}")
            assert list(curve) == list(steps)
            assert np.sqrt(np.mean(np.square(list(curve.values())))) == pytest.approx(rmse, rel=1e-6)
        std = recorded.curve(f"error/{name}/heading_std_deg")[steps[-1]]
        assert std == pytest.approx(degrees(np.sqrt(found.estimates[-1].covariance[4, 4])))
        assert recorded.curve(f"health/{name}/particles").keys() == set(steps)


def test_tracks_join_up_and_start_anew_with_each_agent(session, recorded):
    for name, found in read_run(session / "out").agents.items():
        for kind, track in (("track", found.trajectory), ("true_track", found.truth)):
            pieces = np.array([row["strips"][0] for _, row in recorded.rows[f"world/{name}/{kind}"]])[..., :2]
            np.testing.assert_allclose(pieces[:, 1], track.position_m, atol=1e-5)
            np.testing.assert_allclose(pieces[1:, 0], track.position_m[:-1], atol=1e-5)
            np.testing.assert_allclose(pieces[0, 0], track.position_m[0], atol=1e-5)


def test_grid_lies_as_the_map_does(session, recorded):
    """Rows from the top, corner at the lower left, per cent occupied, 255 where nothing was observed."""
    run = read_run(session / "out")
    assert [step for step, _ in recorded.rows["world/map"]] == [0, 10, 11, 12, 22, 23]
    for step, found in ((STEPS - 1, run.agents["agent1"].map), (2 * STEPS - 1, run.agents["agent2"].map)):
        row = recorded.at("world/map", step)
        (form,), (corner,) = row["format"], row["translation"]
        assert (form["height"], form["width"]) == found.shape
        np.testing.assert_allclose(corner[:2], found.origin_m, atol=1e-6)
        assert row["cell_size"][0] == pytest.approx(found.cell_m)
        cells = np.frombuffer(bytes(row["data"][0]), np.uint8).reshape(found.shape)[::-1]
        np.testing.assert_array_equal(cells == 255, ~found.observed)
        np.testing.assert_allclose(cells[found.observed], 100 * found.occupancy[found.observed], atol=0.5001)


def test_world_stands_still(session, recorded):
    scene = read_run(session / "out").scene
    np.testing.assert_allclose(
        np.array(recorded.static["world/anchors"]["positions"])[:, :2], scene.anchor_positions, atol=1e-6
    )
    assert recorded.static["world/anchors/label"]["labels"] == list(scene.anchor_names)
    assert len(recorded.static["world/walls"]["strips"]) == len(scene.segments())


def test_finished_run_is_shown_again(session, say, recorded):
    result = say("plot", session / "out", "--rerun-to", "again.rrd")
    assert (result.code, result.err) == (0, "")
    again = Recorded("again.rrd")
    assert again.rows["world/paths"] == recorded.rows["world/paths"]
    assert again.rows["world/map"][-1] == recorded.rows["world/map"][-1]
    assert not any(name.startswith("health") for name in again.rows)


def test_several_agents_at_once_share_the_steps(rerun, say, no_figures, tmp_path):
    whole = gs.Scene.load("exchange").model_dump(exclude_none=True)
    agents = [agent | {"steps": 2} for agent in whole["agents"][:2]]
    scene = gs.Scene.checked(whole | {"filter": {"particles": 100}, "agents": agents}, "short")
    (tmp_path / "short.toml").write_text(scene.to_toml())
    result = say("run", "short.toml", "--method", "network", "-o", "out", "--rerun-to", "a.rrd")
    assert result.code == 0, result.err
    shown = Recorded("a.rrd")
    for name, found in read_run("out").agents.items():
        for now in found.estimates:
            place = shown.at(f"world/{name}/now/place", now.step)["positions"]
            np.testing.assert_allclose(np.array(place)[:, :2], [now.position_m], atol=1e-5)
            assert len(shown.at(f"world/{name}/now/paths", now.step)["strips"]) == len(now.paths)
        pieces = np.array([row["strips"][0] for _, row in shown.rows[f"world/{name}/track"]])[..., :2]
        np.testing.assert_allclose(pieces[1:, 0], found.trajectory.position_m[:-1], atol=1e-5)
        assert list(shown.curve(f"error/{name}/position_cm")) == [0, 1]


@pytest.mark.parametrize("heard_in_the_hole", [True, False])
def test_a_true_track_is_broken_at_its_hole_and_has_no_errors_there(monkeypatch, heard_in_the_hole):
    time = np.concatenate([np.arange(3.0), np.arange(20.0, 23.0)])
    track = gs.Trajectory.of_poses(time, np.stack([time, 0 * time], -1))
    logged = dict[str, list]()
    view = RunView.__new__(RunView)
    view.agent, view.truth, view.last, view.seen_s = "me", track, {}, {}
    monkeypatch.setattr(view, "_curve", lambda name, value: logged.setdefault(name, []).append(value))
    monkeypatch.setattr(
        view,
        "_lines",
        lambda name, ends, *_: logged.setdefault(name, []).append(np.ravel(ends)[::2].tolist()),
    )
    for now in [*time[:3], *([8.0, 9.0] if heard_in_the_hole else []), *time[3:]]:
        view._errors(SimpleNamespace(
            time_s=now, position_m=np.array([now, 0.0]), covariance=np.eye(5), heading_rad=0.0
        ))  # fmt: skip
    assert logged["world/me/true_track"] == [[0, 0], [0, 1], [1, 2], [20, 20], [20, 21], [21, 22]]
    assert len(logged["error/position_cm"]) == 6
