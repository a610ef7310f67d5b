"""The likelihood of samples of arrays against dense algebra, and what one path tells, by hand."""

import numpy as np
import pytest
from array_snapshots import LIGHT, NOISE, STEP, band_of, responses, snapshot

from gridslam.inference.beliefs.belief import Belief
from gridslam.inference.messages.samples.array_likelihood import (
    ArrayBand,
    one_more,
    superpose_arrays,
)
from gridslam.inference.messages.samples.array_search import FALSE_PEAKS, find_paths, peak_power
from gridslam.inference.messages.samples.signal_likelihood import Band, superpose
from gridslam.inference.messages.samples.state_mode import PathsPrior
from gridslam.world.radio import aperture

PATH = np.array([[3.0, 0.3, -1.0], [3.6, 0.8, 0.4], [5.0, -2.0, 2.2]])
WEIGHT, BAND = np.array([20.0, 5.0, 1.0]), band_of()


def dense(band, path, samples):
    """Log density and C^-1, written down."""
    column = responses(band, path)
    covariance = NOISE * np.eye(band.samples) + (column.T * WEIGHT[: len(path)]) @ column.conj()
    flat = samples.ravel()
    log = -np.linalg.slogdet(covariance)[1] - np.vdot(flat, np.linalg.solve(covariance, flat)).real
    return log, np.linalg.inv(covariance)


@pytest.mark.slow
def test_all_of_it_is_that_of_the_dense_covariance():
    samples = snapshot(BAND, PATH, [4, 2j, 1])
    found = superpose_arrays(BAND, samples, PATH, WEIGHT, NOISE)
    log, inverse = dense(BAND, PATH, samples)
    column, flat = responses(BAND, PATH), samples.ravel()
    assert found.log_density == pytest.approx(log, rel=1e-12)
    np.testing.assert_allclose(found.matched, column.conj() @ inverse @ flat, rtol=1e-9)
    np.testing.assert_allclose(found.own, np.einsum("nk,kl,nl->n", column.conj(), inverse, column).real)
    assert found.unexplained == pytest.approx(NOISE * np.trace(inverse).real)
    left = flat - found.amplitude @ column
    assert found.rest_power == pytest.approx(np.vdot(left, left).real, rel=1e-9)
    slope, step = np.zeros((3, 3, BAND.samples), complex), 1e-6
    for path in range(3):
        for side in range(3):
            ahead, back = PATH.copy(), PATH.copy()
            ahead[path, side] += step
            back[path, side] -= step
            rise = (dense(BAND, ahead, samples)[0] - dense(BAND, back, samples)[0]) / (2 * step)
            assert found.gradient[path, side] == pytest.approx(rise, rel=1e-5, abs=1e-5)
            slope[path, side] = (responses(BAND, ahead) - responses(BAND, back))[path] / (2 * step)
    scale = found.amplitude.conj()[:, None] * found.amplitude
    whole = 2 * np.einsum("nm,npk,kl,mql->npmq", scale, slope.conj(), inverse, slope)
    whole = whole.real.reshape(9, 9)
    np.testing.assert_allclose(found.information, whole, atol=1e-7 * np.abs(whole).max())


def test_a_path_left_out_is_one_more_on_top_of_the_others():
    samples = snapshot(BAND, PATH, [4, 2j, 1])
    matched, own = superpose_arrays(BAND, samples, PATH, WEIGHT, NOISE).without(WEIGHT)
    for path in range(3):
        rest = np.arange(3) != path
        one, left = one_more(BAND, samples, PATH[[path]], PATH[rest], WEIGHT[rest], NOISE)
        assert matched[path] == pytest.approx(NOISE * abs(one[0]) ** 2)
        assert own[path] == pytest.approx(NOISE * left[0])


def test_one_antenna_is_the_likelihood_of_single_antennas():
    single = ArrayBand(BAND.wavenumber, BAND.pulse, np.zeros((1, 2)), np.zeros((1, 2)))
    samples = snapshot(single, PATH, [4, 2j, 1])
    found = superpose_arrays(single, samples, PATH, WEIGHT, NOISE)
    expected = superpose(Band(BAND.wavenumber, BAND.pulse), samples[0, 0], PATH[:, 0], WEIGHT, NOISE)
    assert found.log_density == pytest.approx(expected.log_density)
    np.testing.assert_allclose(found.gradient[:, 0], expected.gradient)
    np.testing.assert_allclose(found.gradient[:, 1:], 0, atol=1e-12)
    np.testing.assert_allclose(found.information[::3, ::3], expected.information)


def test_one_strong_path_tells_the_deviations_of_m10():
    """3 x 5 antennas 0.4 wavelengths apart: D^2 is 0.16 (25 - 1) / 12 along x, 0.16 (9 - 1) / 12 along y."""
    band, amplitude = band_of(3, 5, 41), 1e4
    flat = ArrayBand(band.wavenumber, np.full(41, 41**-0.5, complex), band.anchor, band.agent)
    path = np.array([[4.0, 0.7, -2.0]])
    samples = snapshot(flat, path, [amplitude], 1e-12)
    found = np.linalg.inv(superpose_arrays(flat, samples, path, np.array([1e8]), 1.0).information)
    beta = STEP * np.sqrt((41**2 - 1) / 12)
    assert np.sqrt(found[0, 0]) == pytest.approx(LIGHT / (np.sqrt(8) * np.pi * beta * amplitude), rel=1e-6)
    for side, spec in ((1, aperture(3, 5, 0.4)), (2, aperture(5, 3, 0.3))):
        across = spec @ np.array([np.sin(path[0, side]) ** 2, np.cos(path[0, side]) ** 2])
        expected = 1 / (np.sqrt(8) * np.pi * amplitude * np.sqrt(across))
        assert np.sqrt(found[side, side]) == pytest.approx(expected, rel=1e-6)
    np.testing.assert_allclose(flat.steepness[0], 2 * np.pi * beta / LIGHT)


NO_TABLE = np.zeros((0, 4), np.int32)


def nothing_known(table=NO_TABLE, weight=()):
    belief = Belief(np.zeros(5), 1e-9 * np.eye(5))
    return PathsPrior(belief, np.array([3.0, 0, 0]), table, np.array(weight), np.zeros((0, 3)))


@pytest.mark.slow
def test_noise_passes_for_a_path_about_as_often_as_it_may():
    """The level counts peaks by Rice's formula, as if all parameters were free of each other."""
    band, none = band_of(2, 2, 9), np.zeros(0)
    found = [
        len(find_paths(band, snapshot(band, PATH[:1], [0.0], seed=n), nothing_known(), NOISE, none).new)
        for n in range(60)
    ]
    assert 0.4 < np.mean(found) / FALSE_PEAKS < 1.6
    assert peak_power(band, 0.01) > peak_power(band, 1.0) + 4


def test_a_new_path_is_found_where_it_is():
    band = band_of(3, 3, 21)
    prior = nothing_known(np.array([[0, -1, -1, 0]], np.int32), [100.0])
    path = np.array([[3.0, np.pi, 0.0], [4.1, 2.2, 0.9]])
    found = find_paths(band, snapshot(band, path, [10, 8j], 1.0), prior, 1.0, np.array([100.0]))
    assert len(found.new) >= 1
    first = int(np.abs(found.new.path[:, 0] - 4.1).argmin())
    off = np.abs(found.new.path[first] - path[1])
    assert (off < 4 * found.new.std[first]).all()
    assert found.new.amplitude[first] == pytest.approx(8, abs=2.5)
