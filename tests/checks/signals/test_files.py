"""Files of sampled signals that aren't what they say: named, and clean ones left in peace."""

import re

import h5py
import numpy as np
import pytest
from signal_samples import C, sampled_scene, suspects

import gridslam as gs
from gridslam.checks.signals.directions import _wrapped_degrees
from gridslam.checks.signals.files import _levels, describe_signal
from gridslam.errors import InputError
from gridslam.io.hdf5_guard import seal
from gridslam.measurements.signal_hdf5 import write_signal
from gridslam.world.geometry import wrap
from gridslam.world.waveform import Waveform

SQUARE = {"rows": 2, "columns": 2, "spacing_wavelengths": 0.4}
WALL = {"material": "concrete", "points_m": [[-6.0, 6.0], [6.0, 6.0]]}
MAST = {"name": "B", "position_m": [5.0, -3.0], "orientation_deg": 120.0}


def scene_of(array):
    scene = sampled_scene(
        [WALL], {"snr_at_1m_db": 45.0, "array": array}, steps=20, step_m=0.05, heading_sensor_deg=0.5
    )
    data = scene.model_dump(exclude_none=True)
    return gs.Scene.checked({**data, "anchors": (*data["anchors"], MAST)}, "two")


SCENES = {"one antenna": scene_of({"rows": 1, "columns": 1}), "arrays": scene_of(SQUARE)}


def written(path, scene, truth=True, **changes):
    """A recording's file with some of its content changed, by functions of what stood there."""
    recording = gs.simulate(scene, "me", 3, what="signal")
    form = recording.waveform
    content = {
        "samples": recording.samples, "carrier_hz": form.carrier_hz, "frequency_hz": form.offset_hz,
        "time_s": recording.time_s, "heard": recording.heard, "pulse": form.pulse, "noise_std": None,
        "anchors": recording.anchors, "anchor_position_m": recording.anchor_position_m,
        "anchor_orientation_rad": recording.anchor_orientation_rad, "anchor_element_m": form.anchor_element_m,
        "agent_element_m": form.agent_element_m, "heading_rad": recording.heading_rad,
        "heading_std_rad": 0.01, "truth": recording.truth if truth else None,
    }  # fmt: skip
    write_signal(path, content | {name: change(content[name]) for name, change in changes.items()})
    return path


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("known", ["track", "start"])
def test_clean_files_are_described_and_raise_no_alarm(tmp_path, name, known):
    scene = SCENES[name]
    path = written(tmp_path / "z.h5", scene, truth=known == "track")
    lines = describe_signal(path, scene if known == "start" else None)
    assert [line for line in lines if line.startswith("suspect")] == []
    text = "\n".join(lines)
    for word in (
        "20 steps, 2 anchors (A, B)",
        "c/B = 0.749 m",
        "29.98 m fold",
        "A: heard at 100%",
        "line of sight: ",
    ):
        assert word in text


@pytest.mark.slow
@pytest.mark.parametrize("name", ["overlap", "screen"])
def test_bundled_scenes_raise_no_alarm(tmp_path, name):
    scene = gs.Scene.load(name)
    gs.simulate(scene, "agent1", 1, what="signal").to_h5(tmp_path / "z.h5")
    for arguments in ((), (scene,)):
        assert suspects(tmp_path / "z.h5", *arguments) == []


WAVELENGTH = C / 6e9
BOTH = "anchor_element_m", "agent_element_m"
FAULTS = {
    "conjugated": ({"samples": np.conj}, "conjugated"),
    "falling": ({"samples": lambda z: z[..., ::-1]}, "falling order"),
    "wavelengths": (
        {n: lambda q: q / WAVELENGTH for n in ("anchor_element_m", "agent_element_m")},
        "wavelengths",
    ),
    "millimetres": ({n: lambda q: 1e3 * q for n in ("anchor_element_m", "agent_element_m")}, "millimetres"),
    "elements": (
        {n: np.negative for n in ("anchor_element_m", "agent_element_m")},
        "element_m: the opposite sign",
    ),
    "to the right": ({n: lambda q: q * [1, -1] for n in BOTH}, "element_m: y to the right"),
    "one to the right": (
        {"agent_element_m": lambda q: q * [1, -1]},
        "element_m of the agent: y to the right",
    ),
    "half": ({n: lambda q: 0.5 * q for n in BOTH}, "element_m: half as far apart"),
    "half of one": ({"anchor_element_m": lambda q: 0.5 * q}, "element_m of the anchors: half as far apart"),
    "exchanged": ({"samples": lambda z: z[:, ::-1]}, "A and B are exchanged"),
    "degrees": ({"heading_rad": np.degrees}, "heading_rad.*degrees"),
    "wrapped degrees": (
        {"heading_rad": lambda h: np.full_like(h, wrap(30.0))},  # as Recording.from_arrays keeps 30 degrees
        "heading_rad: degrees, not radians",
    ),
    "dead": ({"samples": lambda z: z * [[1], [0], [1], [1]]}, "agent: element 2 of 4 hears nothing"),
    "stuck": ({"samples": lambda z: np.repeat(z[:1], len(z), 0)}, "anchor B: snapshots repeat: 19 of 20"),
    "heading": ({"heading_rad": np.negative}, "heading_rad: the opposite sign"),
    "compass": ({"heading_rad": lambda h: np.pi / 2 - h}, "heading_rad: clockwise from north"),
    "north": ({"heading_rad": lambda h: np.pi / 2 - h + 0.7}, "heading_rad: another frame"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_what_arrays_tell_is_named(tmp_path, fault):
    changes, says = FAULTS[fault]
    path = written(tmp_path / "z.h5", SCENES["arrays"], **changes)
    found = suspects(path)
    assert found
    assert any(re.search(says, line) for line in found), found


@pytest.mark.parametrize("name", ["compass", "degrees"])
def test_a_compass_is_told_from_degrees_where_the_agent_keeps_to_its_heading(tmp_path, name):
    scene = gs.Scene.checked(
        {
            **SCENES["arrays"].model_dump(exclude_none=True),
            "agents": [
                {
                    "name": "me", "start_m": [2.0, 3.0], "start_heading_deg": 0.0,
                    "waypoints_m": [[4.0, 3.0]], "steps": 20, "step_m": 0.05, "heading_sensor_deg": 0.5,
                }
            ],
        },
        "ahead",
    )  # fmt: skip
    read = {"compass": lambda h: np.pi / 2 - h, "degrees": lambda h: np.degrees(h + 0.2)}[name]
    path = written(tmp_path / "z.h5", scene, truth=False, heading_rad=read)
    (line,) = suspects(path, scene)
    assert (name == "compass") == ("clockwise from north" in line)


def test_wrapped_degrees_are_told_from_headings_of_another_frame():
    true = np.linspace(0.1, 1.3, 60)
    off = np.random.default_rng(2).normal(scale=np.radians(0.7), size=60)
    assert _wrapped_degrees(wrap(np.degrees(true + off)), true)
    for other in (true + 0.5, -true, true + off + 0.2, np.zeros(60), wrap(np.pi / 2 - true)):
        assert not _wrapped_degrees(other, true)


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("metres", [6.0, -2.5])
def test_a_common_delay_is_named_with_its_size(tmp_path, name, metres):
    scene = SCENES[name]
    turn = np.exp(-2j * np.pi * scene.radio.offset_hz * metres / C)
    path = written(tmp_path / "z.h5", scene, samples=lambda z: z * turn)
    (line,) = suspects(path)
    assert "delays are off" in line
    delay = float(line.split("about ")[1].split(" m")[0])
    assert delay == pytest.approx(metres, abs=0.1)


def test_one_antenna_alone_cannot_tell_conjugation_from_falling_frequencies(tmp_path):
    path = written(tmp_path / "z.h5", SCENES["one antenna"], samples=np.conj)
    (line,) = suspects(path)
    assert "conjugated or with their frequencies in falling order" in line


def test_units_of_frequencies_and_folding_are_named(tmp_path):
    path = written(tmp_path / "z.h5", SCENES["one antenna"], frequency_hz=lambda f: 1e-6 * f)
    assert any("probably MHz, where Hz belong" in line for line in suspects(path))
    wide = sampled_scene([WALL], {"frequency_step_hz": 2.5e7}, steps=3)
    path = written(tmp_path / "y.h5", wide)
    assert suspects(path, wide) == []
    anchors = [
        {**anchor.model_dump(exclude_none=True), "position_m": (-6.0, -6.0)} for anchor in wide.anchors
    ]
    far = gs.Scene.checked({**wide.model_dump(exclude_none=True), "anchors": anchors}, "far")
    assert any("fold back beyond 11.99 m" in line for line in suspects(path, far))


def test_a_file_without_any_place_says_what_was_not_checked(tmp_path):
    path = written(tmp_path / "z.h5", SCENES["arrays"], truth=False)
    assert "not checked" in describe_signal(path)[-1]


@pytest.mark.slow
def test_the_command_line_says_it_all_and_ends_with_what_it_found(say, tmp_path):
    scene = SCENES["arrays"]
    written(tmp_path / "good.h5", scene)
    written(tmp_path / "conj.h5", scene, samples=np.conj)
    written(tmp_path / "wide.h5", scene, **dict.fromkeys(BOTH, lambda q: q / WAVELENGTH))
    assert say("check", "good.h5").code == 0
    result = say("check", "conj.h5")
    assert (result.code, result.err) == (1, "")
    result = say("check", "wide.h5")
    assert result.code == 2
    assert "suspect: element_m: wavelengths" in result.out
    assert "wavelengths to the next" in result.err
    with h5py.File(tmp_path / "good.h5", "r+") as file:
        file["signal/samples"][3, 0] = np.nan
    content = (tmp_path / "good.h5").read_bytes().split(b"gridslam crc32 ")[0]
    (tmp_path / "nan.h5").write_bytes(content + seal(content))
    result = say("check", "nan.h5")
    assert result.code == 2
    assert "samples[3, 0]" in result.err


ODD = {
    "text": np.array([b"x"] * 20),
    "one": np.float64(1),
    "flat": np.zeros(20),
    "nan": np.full((20, 2), np.nan),
    "huge": np.full(41, 1e300),
    "pairs": np.zeros(20, [("a", "f8"), ("b", "i4")]),
    "zeros": np.zeros((20, 2, 1, 1, 41, 2), np.float32),
    "infinite": np.full((20, 2, 1, 1, 41, 2), np.inf, np.float32),
    "none": None,
}
PLACES = (
    "signal/samples", "signal/frequency_hz", "signal/time_s", "signal/heard", "signal/pulse", "anchors/name",
    "anchors/element_m", "anchors/position_m", "agent/element_m", "agent/heading_rad", "truth/position_m",
)  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("place", PLACES)
def test_odd_content_is_described_or_refused_but_never_a_traceback(tmp_path, place):
    scene = SCENES["one antenna"]
    whole = written(tmp_path / "whole.h5", scene).read_bytes().split(b"gridslam crc32 ")[0]
    for kind, value in ODD.items():
        path = tmp_path / f"{kind}.h5"
        path.write_bytes(whole)
        with h5py.File(path, "r+") as file:
            before = dict(file[place].attrs)
            del file[place]
            if value is not None:
                file[place] = value
                file[place].attrs.update(before)
        content = path.read_bytes()
        path.write_bytes(content + seal(content))
        for read in (describe_signal, gs.Recording.load, lambda path: describe_signal(path, scene)):
            assert str(path) in refused(read, path)


@pytest.mark.parametrize("antennas", [1, 4, 25])
def test_the_snr_of_the_strongest_peak_counts_all_antennas_and_no_antenna_twice(antennas):
    """A path of 0 dB at each antenna, before the gain of 200 frequencies, in noise of power 1."""
    draw, own = np.random.default_rng(antennas), 0.01 * np.tile(np.arange(antennas)[:, None], 2)
    offsets = 1e6 * (np.arange(200) - 99.5)
    waveform = Waveform(6e9, offsets, np.ones(200), own[None], np.zeros((1, 2)))
    noise = draw.normal(size=(40, 1, antennas, 1, 200, 2)) @ np.array([1, 1j]) / np.sqrt(2)
    samples = noise + np.exp(-2j * np.pi * waveform.offset_hz * 30.0 / C)
    said = _levels({"anchors": ["A"]}, samples, np.ones((40, 1), bool), waveform)
    assert float(re.search(r"strongest peak (\d+) dB", said[0])[1]) == 23


def refused(read, path):
    """What a reader says; the file's name if it has nothing against it."""
    try:
        read(path)
    except InputError as error:
        return str(error)
    return str(path)


def test_anchors_of_another_scene_are_named(tmp_path):
    path = written(tmp_path / "z.h5", SCENES["one antenna"], anchors=lambda names: ("X", "Y"))
    assert suspects(path) == []
    assert (
        suspects(path, SCENES["one antenna"])[0] == "suspect: anchors: names that aren't the scene's (A, B)"
    )


def test_a_file_of_one_antenna_needs_no_group_of_the_agent(say, tmp_path):
    """All in it may be left out."""
    gs.simulate(SCENES["one antenna"], "me", 1, what="signal").to_h5(tmp_path / "a.h5")
    with h5py.File(tmp_path / "a.h5", "r+") as file:
        del file["agent"]
    content = (tmp_path / "a.h5").read_bytes().split(b"gridslam crc32 ")[0]
    (tmp_path / "a.h5").write_bytes(content + seal(content))
    result = say("check", str(tmp_path / "a.h5"))
    assert (result.code, result.err) == (0, "")
    assert gs.Recording.load(tmp_path / "a.h5").heading_rad is None


def test_snapshots_that_the_scenes_walls_hide_are_not_judged(tmp_path):
    data = SCENES["arrays"].model_dump(exclude_none=True)
    screen = {"reflects": False, "points_m": [[3.5, -4.0], [3.5, -2.0], [4.9, -1.8]]}
    scene = gs.Scene.checked({**data, "walls": (*data["walls"], screen)}, "hidden")
    lines = describe_signal(written(tmp_path / "z.h5", scene), scene)
    assert any("in 20 snapshots" in line for line in lines), "those of A alone, of two anchors"
    assert not [line for line in lines if line.startswith("suspect")]
