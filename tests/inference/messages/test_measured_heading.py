"""A heading that is measured beside the samples corrects the joint belief."""

from dataclasses import replace

import numpy as np
import pytest

import gridslam as gs
from gridslam.inference.beliefs.belief import append
from gridslam.inference.beliefs.layout import HEADING
from gridslam.inference.messages.samples.measured_heading import LEAST_RAD, measure_heading
from gridslam.inference.state.state import State
from gridslam.world.signal_model import SignalModel
from gridslam.world.signal_scan import SignalScan


@pytest.fixture(scope="module")
def model():
    scene = gs.Scene.load("screen")
    return SignalModel.of(scene.filter_model(), scene.waveform())


def believed(model, heading):
    """Agent and a wall, correlated all over."""
    state = State.start(model)
    joint = append(state.belief, np.array([0.2, 4.0]), np.diag([0.01, 0.04]))
    root = np.random.default_rng(4).normal(size=(7, 7)) * 0.1
    joint = replace(joint, mean=joint.mean.copy(), covariance=joint.covariance + root @ root.T)
    joint.mean[HEADING] = heading
    return replace(state, belief=joint)


def measured(model, heading):
    samples = np.zeros(model.waveform.shape, complex)
    return SignalScan(0, 0.0, samples, np.zeros(len(samples), bool), heading)


@pytest.mark.parametrize("std", [0.0, 0.2])
def test_it_is_the_update_of_a_joint_gaussian(model, std):
    """In information form, which shares nothing with the code but Bayes' rule."""
    model = replace(model, waveform=replace(model.waveform, heading_std_rad=std))
    state = believed(model, 0.4)
    after = measure_heading(state, measured(model, 0.7), model).belief
    before, gain = state.belief, 1 / max(std, LEAST_RAD) ** 2
    information = np.linalg.inv(before.covariance)
    pull = information @ before.mean
    information[HEADING, HEADING] += gain
    pull[HEADING] += gain * 0.7
    np.testing.assert_allclose(after.mean, np.linalg.solve(information, pull), atol=1e-7)
    np.testing.assert_allclose(after.covariance, np.linalg.inv(information), atol=1e-8)


def test_headings_are_circular(model):
    state = believed(model, np.pi - 0.01)
    after = measure_heading(state, measured(model, -np.pi + 0.01 + 4 * np.pi), model).belief
    assert np.pi - abs(after.mean[HEADING]) < 0.0101
    np.testing.assert_allclose(after.mean[:2], state.belief.mean[:2], atol=0.05)


def test_without_a_heading_nothing_changes(model):
    state = believed(model, 0.4)
    assert measure_heading(state, measured(model, None), model) is state


def test_a_surprising_heading_counts_in_health(model):
    state = believed(model, 0.4)
    found = [measure_heading(state, measured(model, heading), model).monitor for heading in (0.45, 2.9)]
    assert [one.freedom for one in found] == [1.0, 1.0]
    assert found[0].misfit < 1 < 5 < found[1].misfit <= 30
