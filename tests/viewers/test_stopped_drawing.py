"""Drawing that is stopped midway leaves all figures of before, or none: no page shows some of them."""

import errno
from pathlib import Path

import pytest
from tiny import TINY

import gridslam as gs
from gridslam.errors import InputError, Unwritten
from gridslam.runs.run_files import write_run
from gridslam.viewers.plots import draw_all
from gridslam.viewers.report import write_report


@pytest.fixture
def folder(tmp_path):
    scene = gs.Scene.from_toml(TINY, "tiny")
    heard = gs.simulate(scene, "agent1", seed=1)
    run = gs.map_scene(scene, heard, seed=1, particles=100, method="adaptive")
    write_run(tmp_path / "out", scene, [run], [heard], [run.score(gs.ground_truth(scene, "agent1"))], {})
    return tmp_path / "out"


class Drawn:
    """Instead of figures' files: what was last asked to be drawn is all that they hold."""

    def __init__(self, content, stop_at=None):
        self.content, self.stop_at, self.count = content, stop_at, 0

    def __call__(self, figure, form="png"):
        self.count += 1
        if self.count == self.stop_at:
            raise KeyboardInterrupt
        return self.content


@pytest.mark.slow
def test_no_figure_is_written_before_all_are_drawn(folder, monkeypatch):
    def draw(content, stop_at=None):
        monkeypatch.setattr("gridslam.viewers.plots.encoded", Drawn(content, stop_at))
        return draw_all(folder)

    with pytest.raises(KeyboardInterrupt):
        draw(b"first", stop_at=2)
    assert not (folder / "figures").exists()
    names = {path.name for path in draw(b"second")}
    assert {"agent1-map.png", "agent1-errors.png", "agent1-rays.png"} <= names
    with pytest.raises(KeyboardInterrupt):
        draw(b"third", stop_at=3)
    figures = list((folder / "figures").iterdir())
    assert {path.name for path in figures} == names
    assert {path.read_bytes() for path in figures} == {b"second"}
    assert not [path for path in folder.iterdir() if path.name.startswith(".")]


@pytest.mark.slow
def test_a_report_after_one_that_was_stopped_has_all_figures(folder, monkeypatch):
    monkeypatch.setattr("gridslam.viewers.plots.encoded", Drawn(b"figure", stop_at=3))
    with pytest.raises(KeyboardInterrupt):
        write_report(folder, moving=False)
    assert not (folder / "report.html").exists()
    monkeypatch.setattr("gridslam.viewers.plots.encoded", Drawn(b"figure"))
    page = write_report(folder, moving=False).read_text(encoding="utf-8")
    assert page.count("<img ") == len(list((folder / "figures").iterdir())) >= 3


def test_one_figure_that_fails_costs_no_other(folder, monkeypatch):
    """Neither one that can't be drawn nor one that can't be written; its earlier picture stays."""
    monkeypatch.setattr("gridslam.viewers.plots.encoded", Drawn(b"first"))
    names = {path.name for path in draw_all(folder)}
    write = Path.write_bytes

    def broken(*_, **__):
        raise ValueError("no such colour")

    def full(path, content):
        if path.name == "agent1-map.png":
            raise OSError(errno.ENOSPC, "No space left on device")
        return write(path, content)

    monkeypatch.setattr("gridslam.viewers.plots.encoded", Drawn(b"second"))
    monkeypatch.setattr("gridslam.viewers.plots.draw_rays", broken)
    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(Unwritten) as caught:
        draw_all(folder)
    said = {Path(fault.where): fault.found for fault in caught.value.faults}
    assert said == {
        folder / "figures" / "agent1-rays.png": "ValueError: no such colour",
        folder / "figures" / "agent1-map.png": "No space left on device",
    }
    content = {path.name: path.read_bytes() for path in (folder / "figures").iterdir()}
    assert {name for name, found in content.items() if found == b"first"} == {path.name for path in said}
    assert set(content) == names


@pytest.mark.slow
def test_links_that_lead_out_of_the_folder_are_not_followed(folder, tmp_path, monkeypatch):
    monkeypatch.setattr("gridslam.viewers.plots.encoded", Drawn(b"figure"))
    (tmp_path / "away").mkdir()
    (folder / "figures").symlink_to(tmp_path / "away")
    for write in (draw_all, write_report):
        with pytest.raises(InputError, match="figures: found a link that leads out of the folder"):
            write(folder)
    assert not list((tmp_path / "away").iterdir())
    (folder / "figures").unlink()
    draw_all(folder)
    (tmp_path / "secret.png").write_bytes(b"secret")
    (folder / "figures" / "agent1-map.png").unlink()
    (folder / "figures" / "agent1-map.png").symlink_to(tmp_path / "secret.png")
    with pytest.raises(InputError, match=r"agent1-map\.png: found a link that leads out of the folder"):
        write_report(folder, moving=False)
    draw_all(folder)  # puts its own in the link's place
    assert (tmp_path / "secret.png").read_bytes() == b"secret"
    write_report(folder, moving=False)
