"""Paths before the line of sight say that the agent is elsewhere, while the filter runs."""

from dataclasses import replace

import numpy as np
import pytest

import gridslam as gs
from gridslam.inference.health import reasons
from gridslam.inference.health.early_watch import EARLY, KEEP, arrives_early
from gridslam.inference.scans.anchor_measurements import split_by_anchor
from gridslam.inference.scans.deviations import own_deviations
from gridslam.systems.checkpoint import write_checkpoint

ROOM = gs.Scene.load("room").with_filter(particles=512)
MODEL = ROOM.filter_model("agent1")
HEARD = gs.simulate(ROOM, "agent1", seed=3)


@pytest.fixture
def followed():
    slam = gs.AdaptiveSlam(ROOM, seed=3)
    for step in range(8):
        slam.step(HEARD.scan(step))
    return slam


def early(belief, scan):
    scans = split_by_anchor(scan, MODEL)
    return arrives_early(scans, own_deviations(scans, MODEL.radio), belief, MODEL)


def test_a_place_that_is_off_is_contradicted_and_a_right_or_vague_one_is_not(followed):
    belief, scan = followed.state.belief, HEARD.scan(7)
    assert not early(belief, scan)
    far = belief.mean.copy()
    far[:2] += 2.0 * np.sign(far[:2] - MODEL.anchor_positions.mean(0))  # away from most anchors
    off = replace(belief, mean=far)
    assert early(off, scan)
    wide = belief.covariance.copy()
    wide[:2, :2] += np.eye(2)
    assert not early(replace(off, covariance=wide), scan)
    mute = replace(scan, amplitude=np.full(len(scan), np.nan))
    assert not early(off, mute), "clutter can't be told from paths"
    assert not early(off, replace(scan, distance_m=np.full(len(scan), np.nan)))


def test_health_says_at_what_share_of_the_latest_steps(followed, tmp_path):
    assert followed.population.early == 0
    followed.now = followed.now._replace(believed=replace(followed.population, early=0.5))
    write_checkpoint(followed, tmp_path / "a.h5")
    health = followed.step(HEARD.scan(8)).health
    assert reasons.early(0.5 * KEEP) in health.why
    assert not health.ok
    assert gs.AdaptiveSlam.resume(tmp_path / "a.h5").step(HEARD.scan(8)).health.why == health.why
    followed.now = followed.now._replace(believed=replace(followed.population, early=EARLY))
    assert "line of sight" not in followed.step(HEARD.scan(9)).health.why
    followed.now = followed.now._replace(believed=replace(followed.population, early=1.5))
    write_checkpoint(followed, tmp_path / "b.h5")
    with pytest.raises(gs.InputError, match="early"):
        gs.AdaptiveSlam.resume(tmp_path / "b.h5")


def test_a_line_of_sight_ends_what_is_said_of_reflections_alone(followed):
    state = followed.state
    blind = replace(state, monitor=replace(state.monitor, blind_m=0.8))
    for los, said in ((np.zeros_like(state.los), True), (state.los, False)):
        believed = replace(followed.population, states=(replace(blind, los=los),))
        followed.now = followed.now._replace(believed=believed)
        scan = HEARD.scan(8 if said else 9)
        health = followed.step(replace(scan, amplitude=0.0 * scan.amplitude + 1e-3) if said else scan).health
        assert (reasons.blind(0.8) in health.why) == said
