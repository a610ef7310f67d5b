"""A radio that was off for some steps unlearns nothing."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

import gridslam as gs
from gridslam.inference.messages.outages import is_outage, log_evidence

ROOM = gs.Scene.load("room")
METHODS = [gs.GridSlam, gs.AdaptiveSlam]


def nothing(step):
    none = np.zeros(0)
    return gs.Scan(step=step, time_s=float(step), anchor=none.astype(int), distance_m=none)


def after(method, steps, silent, seed=3):
    """A filter that heard a room for some steps and then nothing; and its map before."""
    slam, heard = method(ROOM, agent="agent1", seed=0), gs.simulate(ROOM, "agent1", seed)
    for step in range(steps):
        slam.step(heard.scan(step))
    before = slam.map()
    for step in range(steps, steps + silent):
        slam.step(nothing(step))
    return slam, before, heard


@pytest.mark.parametrize("method", METHODS)
def test_walls_and_cells_are_after_an_outage_what_they_were_before(method):
    slam, before, heard = after(method, 30, 10)
    now = slam.map()
    np.testing.assert_array_equal(now.surfaces.identity, before.surfaces.identity)
    np.testing.assert_allclose(now.surfaces.existence, before.surfaces.existence, atol=1e-5)
    if method is gs.GridSlam:
        np.testing.assert_array_equal(now.evidence, before.evidence)
    estimate = slam.step(heard.scan(40))
    assert np.hypot(*(estimate.position_m - ROOM.track("agent1").position_m[40])) < 0.1
    assert set(before.surfaces.identity) <= set(slam.map().surfaces.identity)


def test_images_of_virtual_anchors_last_as_well():
    slam, before, _ = after(gs.VirtualAnchorSlam, 30, 10)
    found = before.surfaces.existence > 0.9
    assert found.any()
    np.testing.assert_allclose(
        slam.map().surfaces.existence[found], before.surfaces.existence[found], atol=1e-5
    )


def of_second_anchor(scan):
    """What is left of a scan if nothing of the first anchor is heard."""
    rows = np.asarray(scan.anchor) == 1
    columns = ("anchor", "distance_m", "aod_rad", "aoa_rad", "amplitude")
    return gs.Scan(
        step=scan.step, time_s=scan.time_s, **{name: getattr(scan, name)[rows] for name in columns}
    )


@pytest.mark.parametrize("method", METHODS)
def test_an_anchor_that_goes_silent_alone_was_missed(method):
    slam, _, heard = after(method, 30, 0)
    before = slam.state.los.copy()
    for step in range(30, 33):
        slam.step(of_second_anchor(heard.scan(step)))
    assert before[0] > 0.9
    assert slam.state.los[0] < 0.5
    assert slam.state.los[1] > before[1] - 0.1


def silence(*missed, measurements=0):
    """What an anchor's exchange tells if its paths were missed so likely, of so many measurements."""
    return SimpleNamespace(
        message=np.zeros((5, len(missed), measurements)), log_evidence=sum(map(math.log, missed))
    )


def waiting(off=0):
    """A state for which nobody has listened for so many steps."""
    return SimpleNamespace(monitor=SimpleNamespace(off=off))


@pytest.mark.parametrize(
    ("exchanges", "off"),
    [
        ([silence(0.01), silence(0.2)], False),  # 2 in 1000: rather missed
        ([silence(0.01), silence(0.05)], True),  # 0.5 in 1000
        ([silence(0.01, 0.05), silence()], True),
        ([silence(0.01, 0.05), silence(measurements=1)], False),  # somebody listened
        ([silence(), silence()], False),  # nothing was to be heard
    ],
)
def test_it_takes_paths_that_are_missed_together_once_in_a_thousand_steps(exchanges, off):
    assert is_outage(exchanges, waiting()) is off
    somebody = exchanges[1].message.shape[2] > 0
    assert is_outage(exchanges, waiting(1)) is not somebody  # it lasts until something is heard


def test_a_silence_is_evidence_once_and_no_more_than_an_outage_is_rare():
    """Whoever knows most paths would lose most by it: by hand, log(0.0005 + 0.001), then nothing."""
    exchanges = [silence(0.01), silence(0.05)]
    assert log_evidence(exchanges, waiting(1)) == pytest.approx(math.log(0.0015))
    assert log_evidence(exchanges, waiting(2)) == 0
    assert log_evidence([silence(0.5)], waiting()) == pytest.approx(math.log(0.501))
    assert log_evidence([silence(0.5, measurements=1)], waiting()) is None


@pytest.mark.slow
def test_an_outage_lasts_however_far_motion_alone_leads():
    """It expects ever less there: after 32 steps hardly anything, which isn't to be taken for missed."""
    slam, before, _ = after(gs.GridSlam, 60, 45)
    assert slam.state.monitor.off == 45
    np.testing.assert_allclose(slam.map().surfaces.existence, before.surfaces.existence, atol=1e-5)
    assert (slam.state.los > 0.9).all()
