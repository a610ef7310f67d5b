"""Frequencies in kHz, MHz or GHz are named where no scene tells their spacing: by delays at known places."""

from dataclasses import replace

import numpy as np
import pytest
from signal_samples import C, recording, sampled_scene, suspects

import gridslam as gs

SCENE = sampled_scene(
    [{"material": "concrete", "points_m": [[-6.0, 6.0], [6.0, 6.0]]}], {"snr_at_1m_db": 45.0}, steps=20
)
MAST = {"name": "B", "position_m": [5.0, -3.0], "orientation_deg": 120.0}
SCENE = gs.Scene.checked(
    {**SCENE.model_dump(exclude_none=True), "anchors": (*SCENE.model_dump()["anchors"], MAST)}, "two"
)
DATA = SCENE.model_dump(exclude_none=True)
UNTOLD = gs.Scene.checked({**DATA, "radio": {"snr_at_1m_db": 45.0}}, "untold")
HEARD = gs.simulate(SCENE, "me", 3, what="signal")


def told(path, scene, factor=1.0, truth=True, **changes):
    own = replace(HEARD, waveform=replace(HEARD.waveform, offset_hz=factor * HEARD.waveform.offset_hz))
    replace(own, truth=HEARD.truth if truth else None, **changes).to_h5(path / "z.h5")
    return suspects(path / "z.h5", scene)


@pytest.mark.parametrize(("factor", "unit"), [(1e-3, "kHz"), (1e-6, "MHz"), (1e-9, "GHz")])
@pytest.mark.parametrize(("scene", "truth"), [(UNTOLD, False), (UNTOLD, True), (None, True)])
def test_the_unit_of_frequencies_is_named_by_delays(tmp_path, scene, truth, factor, unit):
    (line,) = told(tmp_path, scene, factor, truth)
    assert line.startswith(
        f"suspect: frequency_hz: probably {unit}, where Hz belong (times {1 / factor:g}): "
    )


@pytest.mark.parametrize(("scene", "truth"), [(UNTOLD, False), (UNTOLD, True), (None, True), (None, False)])
def test_right_frequencies_are_left_in_peace(tmp_path, scene, truth):
    assert told(tmp_path, scene, truth=truth) == []


def test_a_scene_in_the_same_wrong_unit_hides_nothing(tmp_path):
    wrong = gs.Scene.checked({**DATA, "radio": {"frequencies": 41, "frequency_step_hz": 1e4}}, "wrong")
    assert any("probably kHz" in line for line in told(tmp_path, wrong, 1e-3))


def test_without_any_place_steps_that_no_radio_has_are_named(tmp_path):
    (line,) = told(tmp_path, None, 2e-4, truth=False)
    assert line == "suspect: frequency_hz: steps of 2000 Hz, which would be kHz rather than Hz"


def test_a_radio_that_is_narrow_is_no_other_unit(tmp_path):
    """All of its paths are at its first delay, whatever the unit."""
    narrow = 1e-3 * HEARD.waveform.offset_hz
    length = np.linalg.norm(SCENE.anchor_positions - HEARD.truth.position_m[:, None], axis=-1)
    samples = np.exp(-2j * np.pi * narrow * length[..., None] / C)
    own = recording(samples, frequency_hz=narrow, anchors=["A", "B"], time_s=HEARD.time_s)
    replace(own, truth=HEARD.truth).to_h5(tmp_path / "z.h5")
    assert not [line for line in suspects(tmp_path / "z.h5", UNTOLD) if "Hz belong" in line]
