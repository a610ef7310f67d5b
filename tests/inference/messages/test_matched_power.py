"""The power that paths would take, against responses written down; what a band keeps."""

import tracemalloc

import numpy as np
import pytest
from array_snapshots import band_of, responses, snapshot

from gridslam.inference.messages.samples.array_likelihood import FEW, ArrayBand
from gridslam.inference.messages.samples.matched_power import MatchedPower

PATH = np.array([[3.0, 0.3, -1.0]])


@pytest.mark.parametrize("frequencies", [8, 9, FEW, FEW + 1])
def test_it_is_that_of_the_responses_at_every_beam(frequencies):
    band = band_of(2, 3, frequencies)
    samples, beams = snapshot(band, PATH, [4j]), band.beams
    axes = np.meshgrid(beams.length, beams.leaving[1::6], beams.arriving[::6], indexing="ij")
    expected = np.abs(responses(band, np.stack(axes, -1).reshape(-1, 3)).conj() @ samples.ravel()) ** 2
    found = MatchedPower.of(band, samples).power
    assert found.dtype == np.float32
    found = found[1::6, ::6].transpose(2, 0, 1).ravel()
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-6 * expected.max())


def test_thousands_of_frequencies_take_little_memory():
    few = band_of(1, 2)
    slope, pulse = np.linspace(-5, 5, 3000), np.full(3000, 3000**-0.5, complex)
    band = ArrayBand(slope, pulse, few.anchor, few.agent)
    samples = snapshot(band, PATH, [4j])
    tracemalloc.start()
    try:
        found = MatchedPower.of(band, samples)
        _, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert found.power.shape[2] == 2 * 3000
    assert most < 100e6
