"""Amplitudes that are decibels, at whatever level the scene says: their course with the distance tells."""

from dataclasses import replace

import numpy as np
import pytest
from workshop import workshop

import gridslam as gs
from gridslam.checks.columns import loudness as module
from gridslam.checks.columns.loudness import loudness
from gridslam.checks.sights.line_of_sight_filter import explain
from gridslam.checks.verdicts.diagnose import suspicions

SCENE = gs.Scene.load("room")


@pytest.fixture(scope="module")
def heard():
    return gs.simulate(SCENE, "agent1", 1)


@pytest.fixture(scope="module")
def sight(heard):
    return explain(dict(heard.columns), SCENE, "agent1")


def named(amplitude, sight):
    return [(found.kind, found.certain) for found in loudness(amplitude, sight, SCENE)]


@pytest.mark.parametrize("above_db", [0, 10, 20, 30])
def test_decibels_above_another_level_than_the_scene_s_are_named(heard, sight, above_db):
    """From 20 dB on it was the scene's radio.snr_at_1m_db that was called too low."""
    assert named(20 * np.log10(heard.amplitude) + above_db, sight) == [("dB", True)]


@pytest.mark.parametrize("louder_db", [-10, -5, 0, 4, 6, 10, 20, 30])
def test_right_amplitudes_of_a_louder_or_fainter_radio_are_no_decibels(heard, sight, louder_db):
    kinds = [kind for kind, _ in named(heard.amplitude * 10 ** (louder_db / 20), sight)]
    assert kinds == (["level"] if louder_db > 4.5 or louder_db < -5.5 else [])


def test_amplitudes_that_scatter_are_no_decibels(sight):
    """Of faint paths the logarithm scatters more than decibels would: only loud ones are judged so."""
    draw = np.random.default_rng(1)
    near = sight.distance_m[sight.sure]
    amplitude = np.full(sight.row.max() + 1, np.nan)
    for level in (3, 5, 8, 12, 16, 20, 30):
        faded = level * np.median(near) / near * 10 ** (draw.normal(0, 5, len(near)) / 20)
        amplitude[sight.row[sight.sure]] = faded
        assert "dB" not in [kind for kind, _ in named(amplitude, sight)], level


@pytest.mark.parametrize("louder_db", [0, 4])
def test_faint_reflections_beside_lines_of_sight_are_no_decibels(sight, louder_db):
    """Over a corridor's walls they are as long as these; amplitudes were called decibels or powers."""
    draw, near = np.random.default_rng(1), np.linspace(12.2, 1.9, 221)
    off_db = draw.normal(louder_db, 1.0, len(near)) - np.where((near > 7) & (np.arange(221) % 2 > 0), 7, 0)
    amplitude = SCENE.signal_model().amplitude(near)
    corridor = replace(sight, row=np.arange(221), distance_m=near, probability=np.ones(221))
    assert named(amplitude * 10 ** (off_db / 20), corridor) == []
    assert named(20 * np.log10(amplitude) + draw.normal(0, 1.0, len(near)), corridor) == [("dB", True)]


@pytest.mark.parametrize(("least", "spread", "far_m"), [(2.0, 1.0, 6.0), (1.0, 1.0, 8.0), (2.0, 3.0, 8.0)])
def test_small_amplitudes_of_what_is_no_line_of_sight_are_what_they_are_called(
    heard, sight, least, spread, far_m
):
    """Read as decibels they lie near each other, whatever they are; those of 2.0 begin at the threshold."""
    draw, count = np.random.default_rng(1), len(sight.row)
    amplitude = heard.amplitude.copy()
    amplitude[sight.row] = least + spread * draw.exponential(size=count)
    lost = replace(sight, distance_m=draw.uniform(far_m, 2 * far_m, count))
    assert named(amplitude, lost) == []


def test_a_hint_of_decibels_is_no_certainty(heard, sight, monkeypatch):
    monkeypatch.setattr(module, "CERTAIN", 1e6)
    assert named(20 * np.log10(heard.amplitude) + 20, sight) == [("dB", False)]


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_by_distances_alone_reflections_accuse_no_amplitudes(seed):
    """In a scene without walls they pass for lines of sight: amplitudes seemed powers, 3 to 4 dB off."""

    def accused(columns):
        found = suspicions(columns, table.anchors, workshop(walls=False), "r2")
        return [(item.kind, item.certain) for item in found if item.column == "amplitude"]

    table = gs.simulate(workshop(), "r2", seed)
    columns = {name: values for name, values in table.columns.items() if not name.endswith("_rad")}
    assert accused(columns) == []
    assert accused(columns | {"amplitude": columns["amplitude"] ** 2}) == [("power", True)]
