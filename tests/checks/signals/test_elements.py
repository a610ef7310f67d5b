"""Dead antenna elements, snapshots that repeat and glitches are named; sound recordings aren't accused."""

import numpy as np
import pytest

from gridslam.checks.signals.elements import sample_faults

NAMES = ("A", "B")


def noise(shape=(30, 2, 3, 4, 16), seed=1):
    draw = np.random.default_rng(seed)
    return (draw.normal(size=shape) + 1j * draw.normal(size=shape)).astype(np.complex64)


def faults(samples, heard=None):
    there = np.ones(samples.shape[:2], bool) if heard is None else heard
    return sample_faults(samples, there, NAMES)


def test_sound_samples_are_left_in_peace():
    assert faults(noise()) == []
    assert faults(noise((30, 2, 1, 1, 16))) == []  # an only element isn't weaker than others
    assert faults(noise() * np.array([1, 0.4, 0.7, 1])[:, None]) == []  # 8 dB: an uneven array


@pytest.mark.parametrize("scale", [0.0, 1e-2])
@pytest.mark.parametrize(
    ("place", "says"),
    [
        (np.s_[:, :, :, 1], "agent: element 2 of 4 hears nothing: samples[:, :, :, 1]"),
        (np.s_[:, 1, 2], "anchor B: element 3 of 3 hears nothing: samples[:, 1, 2]"),
    ],
)
def test_a_dead_element_is_named_with_its_device(place, says, scale):
    samples = noise()
    samples[place] *= scale
    (line,) = faults(samples)
    assert line.startswith(says)
    assert ("dB weaker than the others" if scale else "is 0 in all") in line


def test_an_anchor_that_is_never_heard_accuses_nobody():
    samples, heard = noise(), np.ones((30, 2), bool)
    samples[:, 1], heard[:, 1] = 0, False
    assert faults(samples, heard) == []


def test_snapshots_that_repeat_are_counted_by_anchor():
    samples = noise()
    samples[10:, 1] = samples[10, 1]
    (line,) = faults(samples)
    assert line.startswith("anchor B: snapshots repeat: 19 of 30")
    samples = noise()
    samples[3] = samples[2]
    assert faults(samples) == []  # one snapshot written twice


@pytest.mark.parametrize("loud", [[12], [0], [29], [5, 6, 20], [2, 9, 15, 21]])
def test_snapshots_that_are_far_too_loud_are_named_with_their_anchor(loud):
    samples, heard = noise(), np.ones((30, 2), bool)
    heard[3:5] = False  # numbers are those of the file's steps
    samples[loud, 1] *= 1e4
    (line,) = faults(samples, heard)
    some = "12" if loud == [12] else ", ".join(map(str, loud[:3])) + " and 1 more" * (len(loud) > 3)
    assert line.startswith(f"anchor B: snapshot{'s' * (len(loud) > 1)} {some} (samples[{loud[0]}, 1]) ")
    assert " 80 dB louder" in line or " 79 dB louder" in line


def test_a_way_past_an_anchor_and_a_gain_that_stays_are_no_glitch():
    samples = noise()
    far = np.hypot(0.05, np.linspace(-3.0, 3.0, 30))
    assert faults(samples / far[:, None, None, None, None]) == []
    near = noise()
    near[11:14] *= np.array([20.0, 60.0, 20.0])[:, None, None, None, None]  # 36 dB, 10 above those beside it
    assert faults(near) == []
    samples[24:] *= 1e3
    assert faults(samples) == []
    assert faults(noise((5, 2, 1, 1, 16)) * np.array([1, 1, 1e4, 1, 1])[:, None, None, None, None]) == []
