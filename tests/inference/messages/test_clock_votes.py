"""Lines of sight vote on clocks pose by pose: what fits one only from poses that others rule out is none."""

import numpy as np
import pytest

import gridslam as gs
from gridslam.inference.beliefs.belief import Belief
from gridslam.inference.messages.network.clock_votes import POSES, Sights, sight_votes
from gridslam.inference.scans.anchor_measurements import whole_scan
from gridslam.inference.state.network.clock_search import CELL_M
from gridslam.systems.network import NetworkSlam
from gridslam.world.scan import Scan

CENTRE = CELL_M * np.arange(-400, 401)
TRUE_M = np.array([4.0, -11.0, 7.5])
ANGLE, DISTANCE = 0.03, 0.02


@pytest.fixture(scope="module")
def hall():
    """What a filter knows of `annex`, with one agent."""
    whole = gs.Scene.load("annex").model_dump(exclude_none=True)
    whole["radio"]["measures"] = ["distance", "aod", "aoa", "amplitude"]
    return NetworkSlam(gs.Scene.checked(whole, "test"), agents=["agent1"], seed=1).model.agents[0]


def lines_of_sight(model, pose):
    """Lengths, departures, arrivals and amplitudes (3,) at a pose."""
    apart = model.anchor_positions - pose[:2]
    length, back = np.hypot(*apart.T), np.arctan2(*apart.T[::-1])
    departing = back + np.pi - model.anchor_orientations
    return length, departing, back - pose[2], model.radio.amplitude(length)


def votes(model, pose, rows, sought=(0, 1, 2), seed=0, spread=(0.4, 0.4, 0.2)):
    """Votes about the offsets by rows of (length, departure, arrival, amplitude), without labels."""
    length, aod, aoa, amplitude = np.array(rows, float).T
    turn = np.angle(np.exp(1j * np.array([aod, aoa])))
    scan = Scan(0, 0.0, np.full(len(rows), -1), length, *turn, amplitude)
    heard, anchors = whole_scan(scan, model), len(TRUE_M)
    mean = np.array([pose[0] + 0.2, pose[1] - 0.1, 0, 0, pose[2] + 0.1, *np.zeros(anchors)])
    variance = np.concatenate([np.square(spread[:2]), [0.1, 0.1], [spread[2] ** 2], np.zeros(anchors)])
    std = np.tile([DISTANCE, ANGLE, ANGLE], (anchors, len(rows), 1))
    sights = Sights(
        np.full(anchors, 0.5), std, np.ones((anchors, len(rows)), bool),
        np.full((anchors, len(rows)), len(rows) / (model.radio.span_m * 4 * np.pi**2)),
    )  # fmt: skip
    flat, own = np.full((anchors, len(CENTRE)), 1 / len(CENTRE)), np.isin(np.arange(anchors), sought)
    return sight_votes(
        Belief(mean, np.diag(variance), anchors), sights, heard, model, own, ~own & False, flat, CENTRE,
        np.random.default_rng(seed),
    )  # fmt: skip


@pytest.mark.parametrize("seed", range(6))
def test_votes_stand_for_the_true_offsets(hall, seed):
    draw = np.random.default_rng(seed)
    pose = np.array([*draw.uniform(-4, 4, 2), draw.uniform(-3, 3)])
    length, aod, aoa, amplitude = lines_of_sight(hall, pose)
    noise = ANGLE * draw.standard_normal((2, 3))
    found = votes(hall, pose, np.transpose([length + TRUE_M, aod + noise[0], aoa + noise[1], amplitude]))
    np.testing.assert_allclose(CENTRE[found.argmax(1)], TRUE_M, atol=0.9)
    assert (found.max(1) - np.median(found, axis=1) > 5).all()


def test_a_reflection_that_fits_from_another_heading_alone_counts_for_little(hall):
    """A hidden anchor's departure, and its arrival if the agent were turned: the others say that it isn't."""
    pose, turn = np.array([1.0, 1.0, 0.3]), 0.35
    length, aod, aoa, amplitude = lines_of_sight(hall, pose)
    decoy = (length[2] + 20.0, aod[2], aoa[2] - turn, amplitude[2])
    seen = [(length[k] + TRUE_M[k], aod[k], aoa[k], amplitude[k]) for k in range(2)]

    def nats(rows):
        found = votes(hall, pose, rows)[2]
        return found.max() - np.median(found)

    assert nats([decoy]) > 6
    assert nats([*seen, decoy]) < 3


def test_near_an_anchor_a_faint_reflection_isn_t_its_line_of_sight(hall):
    """Its angles are known too little there to tell; its amplitude is as strong as it is near."""
    x, y = hall.anchor_positions[0]
    pose = np.array([x + 0.6, y - 0.4, 0.5])
    length, aod, aoa, amplitude = lines_of_sight(hall, pose)
    rows = [(length[0] + 4, aod[0], aoa[0], amplitude[0]), (length[0] + 9.7, aod[0] + 0.3, aoa[0] + 0.3, 8.0)]
    found = votes(hall, pose, rows, sought=(0,), spread=(0.3, 0.3, 0.1))[0]
    right, wrong = (found[np.abs(CENTRE - offset) < 1].max() for offset in (4.0, 9.7))
    assert right > wrong + 3


def test_nothing_that_was_measured_says_nothing(hall):
    found = votes(hall, np.array([1.0, 1.0, 0.3]), [(np.nan, 0.1, 0.1, 5.0)])
    assert not found.any()
    assert POSES > 1000
