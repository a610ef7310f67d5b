"""`check` reads all that the project writes, and says of damaged files what is wrong with them."""

from pathlib import Path

import pytest
from tiny import TINY


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A run's folder and an export of its map."""
    import sys

    from gridslam.cli.main import main

    folder = tmp_path_factory.mktemp("made")
    (folder / "tiny.toml").write_text(TINY)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setattr("gridslam.viewers.plots.draw_all", lambda folder: [])
        for words in (["run", "tiny.toml", "-o", "out"], ["simulate", "tiny.toml", "-o", "heard.csv"]):
            patch.setattr(sys, "argv", ["gridslam", *words])
            with pytest.raises(SystemExit) as stop:
                main()
            assert stop.value.code == 0
    return folder


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("out", "run of tiny by grid: agent1 (3 steps, "),
        ("out/run.json", "run of tiny by grid: agent1 (3 steps, "),
        ("out/scene.toml", "scene tiny: 2 anchors, 1 walls, 2 agents"),
        ("out/map.h5", "map by agent1, agent2: 48 x 38 cells of 0.2 m"),
        ("out/map.yaml", "nav2 map: 48 x 38 cells of 0.2 m, lower left corner at -4.8, -3.8 m; "),
        ("out/map.pgm", "nav2 map: 48 x 38 cells of 0.2 m, "),
        ("out/agent1/steps.h5", "estimates over 3 steps (steps 0 to 2, 0 to 2 s): at the end "),
        ("out/agent1/trajectory.tum", "track: 3 poses, 0 to 2 s, "),
        ("out/agent2/truth.tum", "track: 2 poses, 0 to 1 s, "),
        ("out/agent1/measurements.h5", "measurements"),
        ("heard.csv", "measurements"),
        ("room", "scene room: 2 anchors, "),
    ],
)
def test_every_file_of_a_run_is_told(say, made, name, told):
    said = say("check", made / name if name != "room" else name)
    assert (said.code, said.err) == (0, "")
    assert told in said.out


def test_every_file_that_a_run_leaves_can_be_checked(say, made):
    for path in (made / "out").rglob("*.*"):
        if path.suffix not in (".png",):
            assert say("check", path).code == 0, path


def test_study_is_told(say, made):
    Path("study").mkdir()
    Path("study/study.jsonl").write_text('{"format": "gridslam-study"}\n{"agents": {}}\n{"agents": {}}\n')
    assert "study: 2 finished runs" in say("check", "study").out
    Path("study/study.jsonl").write_text("{")
    assert say("check", "study").code == 2


@pytest.mark.parametrize(
    ("name", "spoil"),
    [
        ("map.pgm", lambda content: content[:-1]),
        ("map.pgm", lambda content: b"P2" + content[2:]),
        ("map.pgm", lambda content: b"P5 99999999 1 255\n0"),
        ("map.yaml", lambda content: content.replace(b"resolution: 0.2", b"resolution: wide")),
        ("map.yaml", lambda content: content.replace(b"origin", b"begin")),
        ("map.yaml", lambda content: b"\xff" + content),
        ("agent1/steps.h5", lambda content: content[: len(content) // 2]),
        ("agent1/trajectory.tum", lambda content: b"1 2 3\n"),
    ],
)
def test_damaged_file_is_refused_in_one_line(say, made, name, spoil):
    for other in ("map.yaml", "map.pgm", name):
        Path(other).parent.mkdir(exist_ok=True)
        Path(other).write_bytes((made / "out" / other).read_bytes())
    spoilt = spoil(Path(name).read_bytes())
    assert spoilt != Path(name).read_bytes()
    Path(name).write_bytes(spoilt)
    said = say("check", name)
    assert (said.code, len(said.complaints)) == (2, 1), said
