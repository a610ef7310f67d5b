"""Samples in the order of an FFT, or over time: named; right ones, with and without pulses, are not."""

import numpy as np
import pytest
from signal_samples import sampled_scene, suspects

import gridslam as gs
from gridslam.checks.signals.order import order_note, over_time, shift_of
from gridslam.cli.observed import hints

WALL = {"material": "concrete", "points_m": [[-6.0, 6.0], [6.0, 6.0]]}
RADIO = {"snr_at_1m_db": 40.0}
RADIOS = {
    "odd": RADIO,
    "even": RADIO | {"frequencies": 40},
    "pulse": RADIO | {"pulse": {"width_hz": 2.5e8, "rolloff": 0.6}},
}
ORDERS = {
    "fftshift": lambda z: np.fft.ifftshift(z, axes=-1),
    "time": lambda z: np.fft.ifft(z, axis=-1),
    "time, in order": lambda z: np.fft.ifft(np.fft.ifftshift(z, axes=-1), axis=-1),
}
SAYS = {"fftshift": "in the order of an FFT", "time": "a response over time"}


def told(path, radio, change=lambda z: z, **more):
    """What is suspected of a recording, some of it changed, and its snapshots with their waveform."""
    scene = sampled_scene([WALL], radio, steps=20, step_m=0.05)
    own = gs.simulate(scene, "me", 3, what="signal")
    samples, form = change(own.samples), own.waveform
    given = gs.Recording.from_arrays(
        samples, form.carrier_hz, form.offset_hz, list(own.anchors), pulse=form.pulse, truth=own.truth,
        anchor_position_m=own.anchor_position_m, anchor_orientation_rad=own.anchor_orientation_rad,
        time_s=own.time_s, **more,
    )  # fmt: skip
    given.to_h5(path / "z.h5")
    return suspects(path / "z.h5", scene), samples[own.heard], form


@pytest.mark.parametrize("name", RADIOS)
def test_right_samples_are_not_accused(tmp_path, name):
    found, snapshots, form = told(tmp_path, RADIOS[name])
    assert (found, shift_of(snapshots, form), over_time(snapshots, form)) == ([], 0, False)


@pytest.mark.parametrize("name", RADIOS)
@pytest.mark.parametrize("order", ORDERS)
def test_another_order_is_named(tmp_path, name, order):
    found = told(tmp_path, RADIOS[name], ORDERS[order])[0]
    (line,) = [line for line in found if line.startswith("suspect: samples: ")]
    assert SAYS[order.split(",")[0]] in line


def test_the_roll_that_undoes_it_is_told_for_odd_numbers_of_samples(tmp_path):
    for undone, roll in ((np.fft.ifftshift, 20), (np.fft.fftshift, 21)):
        _, snapshots, form = told(tmp_path, RADIO, lambda z, undone=undone: undone(z, axes=-1))
        assert shift_of(snapshots, form) == roll


def test_a_line_at_the_carrier_is_no_break(tmp_path):
    """A receiver's own carrier, or none there, at one frequency."""
    for level in (0.0, 30.0):

        def spoilt(z, level=level):
            z = z.copy()
            z[..., 20] = level * np.abs(z).max()
            return z

        _, snapshots, form = told(tmp_path, RADIO, spoilt)
        assert shift_of(snapshots, form) == 0
        assert order_note(snapshots[:, None], np.ones((len(snapshots), 1), bool), form) is None


def test_noise_has_no_order():
    draw = np.random.default_rng(0)
    form = gs.simulate(sampled_scene(), "me", 1, what="signal").waveform
    for _ in range(20):
        noise = draw.standard_normal((60, 1, 1, 41)) + 1j * draw.standard_normal((60, 1, 1, 41))
        assert shift_of(noise, form) == 0
        assert not over_time(noise, form)


def test_a_run_says_so_before_it_begins(tmp_path):
    for name, change in {"": lambda z: z, **ORDERS}.items():
        told(tmp_path, RADIO, change)
        own = gs.Recording.load(tmp_path / "z.h5")
        found = hints(sampled_scene([WALL], RADIO), "direct", own)
        assert [line for line in found if SAYS[name.split(",")[0]] in line] if name else not found


@pytest.mark.parametrize("leak", [3.0, 10.0])
def test_a_carrier_that_leaks_and_few_frequencies_tell_no_order(tmp_path, leak):
    """What stands alone in the middle breaks off on both sides."""
    for frequencies in (16, 32):
        radio = RADIO | {"frequencies": frequencies}
        level = leak * np.sqrt(np.mean(np.abs(told(tmp_path, radio)[1]) ** 2))
        middle = level * (np.arange(frequencies) == frequencies // 2)
        _, snapshots, form = told(tmp_path, radio, lambda z, middle=middle: z + middle)
        assert shift_of(snapshots, form) == 0
