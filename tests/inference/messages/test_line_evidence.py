"""Walls that no single snapshot tells from noise, and their coefficients."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest

import gridslam as gs
from gridslam import runtime
from gridslam.inference.messages.samples.array_likelihood import ArrayBand, composed
from gridslam.inference.messages.samples.array_updates import coefficient_ratios
from gridslam.inference.messages.samples.line_evidence import (
    FAINT_SURE,
    LOUD,
    MEMORY,
    SURE,
    add_faint_surfaces,
    likeliest_line,
)
from gridslam.inference.messages.samples.matched_power import MatchedPower
from gridslam.inference.scans.leftovers import REFLECTIONS, LineEvidence
from gridslam.inference.state.presence import Presence
from gridslam.inference.state.rays import Rays
from gridslam.inference.workspace.workspace import Workspace
from gridslam.world.radio import BINS, REFLECTION_BINS

runtime_started = pytest.fixture(scope="module", autouse=True)(lambda: runtime.start())
RADIUS, MIDDLE = 5.0, np.array([1.0, -0.5])
MODEL = SimpleNamespace(radius_m=RADIUS, middle=MIDDLE, birth_rate=0.1 / (4 * np.pi * RADIUS))


def with_peak(angle, offset, width, height, coefficients):
    """Evidence of two anchors for a line, about the middle, as a bell."""
    by_line = LineEvidence.none(2, RADIUS, 0.1)
    angles, offsets = by_line.angles()[:, None], by_line.offsets(RADIUS)
    turn = np.mod(angles - angle + 0.5 * np.pi, np.pi) - 0.5 * np.pi
    flip = np.where(np.abs(angles - angle) > 0.5 * np.pi, -1, 1)
    bell = np.exp(-0.5 * (turn / width[0]) ** 2 - 0.5 * ((flip * offsets - offset) / width[1]) ** 2)
    return LineEvidence(
        1 + np.exp(height) * bell[None, :, :, None] * np.array(coefficients) * np.ones((2, 1, 1, 1))
    )


@pytest.mark.parametrize("angle", [0.02, 1.0, 3.13])
def test_likeliest_line_and_its_spread_are_those_of_the_evidence(angle):
    width = np.array([0.03, 0.12])
    line, covariance, odds, reflection = likeliest_line(
        with_peak(angle, 2.0, width, 9.0, [0, 0, 1, 0.5]), MODEL
    )
    normal = np.array([np.cos(line[0]), np.sin(line[0])])
    turned = np.angle(np.exp(2j * (line[0] - angle))) / 2
    assert abs(turned) < 0.01
    sign = np.sign(np.cos(line[0] - angle))
    assert sign * (line[1] - MIDDLE @ normal) == pytest.approx(2.0, abs=0.03)
    # two anchors: the evidence is a bell squared, and half a step of the lines' grid
    step = np.array([np.pi / len(LineEvidence.none(1, RADIUS, 0.1).angles()), 0.1])
    np.testing.assert_allclose(
        np.sqrt(np.diagonal(covariance)), np.sqrt(width**2 / 2 + step**2 / 12), rtol=0.1
    )
    assert odds > 1e3
    assert reflection.argmax() == 2


def test_faint_evidence_is_none_and_for_what_is_as_faint_as_a_double_bounce_more_is_needed():
    assert likeliest_line(LineEvidence.none(2, RADIUS, 0.1), MODEL) is None
    assert likeliest_line(with_peak(1.0, 2.0, (0.03, 0.12), 2.0, [0, 0, 1, 1]), MODEL) is None
    assert REFLECTIONS[1] < LOUD < REFLECTIONS[2]
    loud = likeliest_line(with_peak(1.0, 2.0, (0.03, 0.12), 6.0, [0, 0, 1, 0.5]), MODEL)
    assert loud is not None
    assert SURE < loud[2] < FAINT_SURE
    assert likeliest_line(with_peak(1.0, 2.0, (0.03, 0.12), 6.0, [0.5, 1, 0, 0]), MODEL) is None
    faint = likeliest_line(with_peak(1.0, 2.0, (0.03, 0.12), 9.0, [0.5, 1, 0.2, 0]), MODEL)
    assert faint is not None
    assert faint[2] > FAINT_SURE


@dataclass(frozen=True)
class Believed:
    belief: SimpleNamespace
    by_line: LineEvidence


def test_evidence_is_forgotten_where_paths_turn_less_than_three_radians_from_those_of_what_was_born():
    """Of 33 frequencies 16 MHz apart, 2 pi / c times 16 MHz sqrt((33^2 - 1) / 12) are 3.193 rad/m.

    3 rad are 0.940 m of a path; of walls square to the way back and forth, 0.470 m.
    """
    frequencies = 1.6e7 * (np.arange(33) - 16)
    flat, one = np.full(33, 33**-0.5 + 0j), np.zeros((1, 2))
    band = ArrayBand(2 * np.pi * frequencies / 299_792_458.0, flat, one, one)
    by_line = with_peak(0.0, 2.0, (0.03, 0.12), 9.0, [0, 0, 1, 0.5])
    pose, place = np.array([1.0, -0.5, 0.0, 0.0, 0.0]), np.array([0.5, -0.5, 0.0, 0.0])
    model = SimpleNamespace(**vars(MODEL), places=np.array([place, place]))
    line = likeliest_line(by_line, MODEL)[0]
    length = 2 * line[1] - 1.5  # there and back to x = line[1]
    path = SimpleNamespace(found=SimpleNamespace(mode=SimpleNamespace(path=np.array([[length, 0.0, 0.0]]))))
    listened = [(SimpleNamespace(anchor=0, band=band), path)]
    state = Believed(SimpleNamespace(mean=pose), by_line)
    work = Workspace(gs.Scene.load("room").filter_model("agent1"), 1)
    after = add_faint_surfaces(state, listened, model, work=work).by_line
    offset = by_line.offsets(RADIUS) + MIDDLE[0]
    loud = by_line.ratio[0, 0, :, 2] > 1 + 1e-9
    gone = (after.ratio[0, 0, :, 2] == 1) & loud
    np.testing.assert_array_equal(gone, (np.abs(offset - line[1]) < 0.470) & loud)
    assert 0 < gone.sum() < loud.sum()
    np.testing.assert_array_equal(after.ratio[1], by_line.ratio[1])  # nothing was heard of this anchor


@pytest.mark.slow
def test_noise_makes_no_line_likely():
    from gridslam.kernels.messages.line_evidence import weigh_lines

    draw, by_line = np.random.default_rng(3), LineEvidence.none(2, RADIUS, 0.2)
    pose = np.array([0.3, -0.4, 0.2, *MIDDLE])
    sure = 0
    for step in range(256):
        pose[:2] += 0.04 * np.array([np.cos(step / 20), np.sin(step / 20)])
        for anchor, place in enumerate(([3.0, 1.0, 0.0, 0.0], [-2.0, -2.5, 1.0, 0.0])):
            weigh_lines(
                draw.exponential(size=(12, 12, 60)).astype(np.float32), 1.0, 20.0, np.array(place), pose,
                by_line.offsets(RADIUS), 10 * REFLECTIONS, np.array([0.9, 1 / MEMORY]), 0,
                by_line.ratio[anchor],
            )  # fmt: skip
        sure += likeliest_line(by_line, MODEL) is not None
    assert sure == 0


@pytest.mark.slow
def test_walls_too_faint_for_one_snapshot_are_found_where_they_are():
    scene = gs.Scene.load("room").model_dump(exclude_none=True)
    scene["radio"] |= {
        "frequencies": 33, "frequency_step_hz": 1.6e7, "snr_at_1m_db": 21.0,
        "array": {"rows": 3, "columns": 3, "spacing_wavelengths": 0.4},
    }  # fmt: skip
    for key in ("bandwidth_hz", "max_distance_m", "samples"):
        scene["radio"].pop(key, None)
    scene = gs.Scene.checked(scene, "room")
    recording = gs.simulate(scene, "agent1", seed=5, what="signal")
    slam = gs.DirectGridSlam(scene, waveform=recording.waveform)
    for number in range(55):
        slam.step(recording.scan(number))
    line = slam.map().surfaces.line
    assert len(line) >= 2
    sides = np.stack([line[:, 1] * np.cos(line[:, 0]), line[:, 1] * np.sin(line[:, 0])], 1)
    walls = np.array([[4.0, 0.0], [-4.0, 0.0], [0.0, 3.0], [0.0, -3.0]])
    away = np.linalg.norm(sides[:, None] - walls, axis=2).min(1)
    assert (away < 0.5).all(), away


def test_coefficients_of_faint_walls_are_not_taken_for_louder_ones():
    """Loud snapshots were laid to the wall and faint ones to an obstacle: 0.7 became 0.9."""
    draw, steps, truth, at_1m = np.random.default_rng(7), 250, 0.7, 8.0
    rays = Rays.of(0, 1, 0, -1, np.array([0.6]), np.array([1.0]))
    found = []
    for _ in range(12):
        belief, before = np.zeros(BINS), np.full((1, BINS), -1.0)
        for _ in range(steps):
            amplitude = truth * at_1m / 6.0
            y = amplitude + (draw.normal() + 1j * draw.normal()) / np.sqrt(2)
            snapshot = SimpleNamespace(
                rays=rays, open_=np.array([0.6]), length=np.array([6.0]), fades=False,
                radio=SimpleNamespace(amplitude_at_1m=at_1m),
            )  # fmt: skip
            scan = SimpleNamespace(matched=np.array([abs(y) ** 2]), own=np.ones(1))
            ratio, before = coefficient_ratios(snapshot, scan, np.array([0.5]), before)
            belief += ratio[0, 0]
        weight = np.exp(belief - belief.max())
        found.append(weight @ REFLECTION_BINS / weight.sum())
    assert np.mean(found) == pytest.approx(truth, abs=0.03)


def test_presence_follows_its_surface_through_births_and_losses():
    chance = np.arange(2 * 2 * BINS, dtype=float).reshape(2, 2, BINS) / 100
    known = Presence(np.array([4, 9]), chance).of(np.array([9, 11, 4]))
    np.testing.assert_array_equal(known.chance[:, 0], chance[:, 1])
    np.testing.assert_array_equal(known.chance[:, 2], chance[:, 0])
    assert (known.chance[:, 1] == -1).all()
    assert Presence.none(2).of(np.array([3])).chance.shape == (2, 1, BINS)


def test_table_of_powers_has_a_path_where_it_is_and_known_ones_are_taken_out():
    scene = gs.Scene.load("chamber")
    band = ArrayBand.of(scene.waveform("agent1"), 0)
    path = np.array([[6.1, 0.4, -1.2], [9.0, -2.0, 2.0]])
    samples = composed(band, path, np.array([10.0 + 0j, 4.0j]))
    power = MatchedPower.of(band, samples)
    gap = (power.highest - path[0]) * band.steepness
    assert np.abs(gap).max() < 0.6
    assert power.power.max() == pytest.approx(100.0, rel=0.4)
    left = samples - composed(band, path[:1], np.array([10.0 + 0j]))
    assert np.abs(MatchedPower.of(band, left).highest - path[1]).max() < 0.3
    assert (power.without(path[:1]).power < 0).any()
