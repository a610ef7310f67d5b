"""Numbers worked out by hand: what simulator and filter share, and a twin would get wrong alike."""

from dataclasses import replace

import numpy as np
import pytest

import gridslam as gs
from gridslam.estimate_tables import SurfaceEstimate
from gridslam.inference.beliefs.particles import Particles
from gridslam.kernels.primitives import tables
from gridslam.simulation.image_source import true_paths
from gridslam.systems.registry import method_class
from gridslam.world.radio import REFLECTION_BINS

NONE = np.zeros(0)


def scene_of(anchor_deg=90.0, radio=None, walls=(), filter=None, **agent):
    """One anchor at (0, 0) in a region of 14 m by 14 m about it, an agent at (3, 4) that faces 30 degrees."""
    own = {"name": "me", "start_m": [3.0, 4.0], "start_heading_deg": 30.0, **agent}
    return gs.Scene.checked(
        {
            "grid": {"x_m": [-7.0, 7.0], "y_m": [-7.0, 7.0], "cell_m": 0.5}, "radio": radio or {},
            "anchors": [{"name": "A", "position_m": [0.0, 0.0], "orientation_deg": anchor_deg}],
            "walls": list(walls), "agents": [own], "filter": {"particles": 512, **(filter or {})},
        },
        "by hand",
    )  # fmt: skip


def silence(time_s=0.0):
    return gs.Scan(0, time_s, np.zeros(0, np.intp), NONE, NONE, NONE, NONE)


def wall(existence=0.95, offset=6.0):
    """A known surface: the line y = `offset`, sure to a tenth of a millimetre."""
    return SurfaceEstimate.from_lines(
        np.array([[np.pi / 2, offset]]), 1e-8 * np.eye(2)[None], np.array([0.5]), np.array([0.01]),
        np.array([existence]), np.full((1, 2), np.nan), np.arange(1),
    )  # fmt: skip


def test_deviations_of_a_path_of_amplitude_ten():
    signal = scene_of(radio={"bandwidth_hz": 1e9}).signal_model("me")
    # c / (sqrt(8) pi beta u), beta = 1e9 / sqrt(12) = 288.68 MHz:
    # 299 792 458 / (8.8858 x 288.675e6 x 10) = 11.687 mm
    assert signal.distance_std(np.array(10.0)) == pytest.approx(0.011687, rel=1e-4)
    assert signal.numbers[0, 0] / 10 == pytest.approx(0.011687, rel=1e-4), "as kernels take it"
    # 5 antennas in steps of 1/4 wavelength: mean square extent (1/16) (0 + 1 + 1 + 4 + 4) / 5 = 1/8 across
    # any direction; 1 / (sqrt(8) pi 10 sqrt(1/8)) = 1 / (10 pi) = 0.031831 rad = 1.824 degrees
    for angle in (0.0, 0.7, 2.0):
        assert signal.angle_std(10.0, angle, signal.agent_aperture) == pytest.approx(0.031831, rel=1e-4)
        assert signal.angle_std(10.0, angle, signal.anchor_aperture[0]) == pytest.approx(0.031831, rel=1e-4)
    # 1/2 + 10^2 / (4 x 2500) = 0.51
    assert signal.amplitude_std(np.array(10.0)) ** 2 == pytest.approx(0.51)


def test_strength_at_a_metre_and_beyond():
    signal = scene_of(radio={"snr_at_1m_db": 30.0, "detection_threshold_db": 6.0}).signal_model("me")
    assert signal.amplitude_at_1m == pytest.approx(31.6228, rel=1e-5)  # sqrt(1000)
    assert signal.threshold == pytest.approx(1.99526, rel=1e-5)  # sqrt(3.98107)
    assert signal.amplitude(5.0, 0.5) == pytest.approx(3.16228, rel=1e-5)


def test_angles_of_a_drawn_example_in_simulator_and_filter():
    """The anchor looks north (90 degrees), the agent at (3, 4) looks 30 degrees north of east; a wall y = 6.

    Line of sight, 5 m: leaves at atan2(4, 3) = 53.130 degrees, 36.870 to the right of north; comes from
    atan2(-4, -3) = -126.870, and -156.870 from where the agent looks. By the wall, the image of the anchor
    is (0, 12) and that of the agent (3, 8): sqrt(9 + 64) = 8.5440 m; leaves at atan2(8, 3) = 69.444, which is
    -20.556 from north; comes from atan2(8, -3) = 110.556, which is 80.556 from where the agent looks; and
    hits the wall at 3 x 6 / 8 = 2.25 m.
    """
    length, aod, aoa = [5.0, 8.5440], [-36.870, -20.556], [-156.870, 80.556]
    walls = [{"material": "concrete", "points_m": [[-6.0, 6.0], [6.0, 6.0]]}]
    ahead = [3.0 + np.cos(np.pi / 6), 4.0 + 0.5]
    paths = true_paths(scene_of(walls=walls, waypoints_m=[ahead], steps=1), "me")
    still = {"position_m": 0.0, "velocity_mps": 0.0, "heading_deg": 0.0}
    silent = {"snr_at_1m_db": 0.0, "detection_threshold_db": 20.0}  # so that silence says nothing
    scene = scene_of(radio=silent, prior=still, step_m=1e-4)
    known = replace(gs.GridSlam(scene).map(), surfaces=wall(), surface_reflection=None)
    slam = gs.GridSlam(scene, prior_map=known)
    bank = replace(slam.state.surfaces, single=np.full_like(slam.state.surfaces.single, 0.99))
    slam.now = slam.believing(replace(slam.state, surfaces=bank))
    believed = slam.step(silence()).paths
    for found in (paths, believed):
        assert len(found.distance_m) == 2
        order = np.argsort(found.distance_m)
        np.testing.assert_allclose(found.distance_m[order], length, atol=1e-3)
        np.testing.assert_allclose(np.degrees(found.aod_rad)[order], aod, atol=2e-3)
        np.testing.assert_allclose(np.degrees(found.aoa_rad)[order], aoa, atol=2e-3)
        np.testing.assert_allclose(found.points[order[1], 1], [2.25, 6.0], atol=1e-3)


def test_silence_of_a_while_widens_the_belief_by_its_length():
    scene = scene_of(filter={"acceleration_mps2": 0.04, "heading_deg": 7.0}, interval_s=2.5, step_m=0.1)
    slam = gs.GridSlam(scene)
    slam.step(silence(10.0))
    mean = slam.state.belief.mean.copy()
    mean[2:4] = 0.2, -0.1
    slam.now = slam.believing(replace(slam.state, belief=replace(slam.state.belief, mean=mean)))
    slam.step(silence(12.5))
    # in 2.5 s at (0.2, -0.1) m/s from (3, 4): (3.5, 3.75)
    np.testing.assert_allclose(slam.state.belief.mean[:2], [3.5, 3.75], atol=1e-9)
    # velocity: the prior's 0.01^2 / 3, the step's (0.1 / 2.5)^2 (1.63333e-3), and (0.04 x 2.5)^2 = 0.01 more;
    # position: 0.5^2 / 3 and 2.5^2 x 1.63333e-3 = 0.0102083, and (0.5 x 0.04 x 2.5^2)^2 = 0.015625
    own = np.diag(slam.state.belief.covariance)
    np.testing.assert_allclose(own[2:4], 1.163333e-2, rtol=1e-5)
    np.testing.assert_allclose(own[:2], 0.0833333 + 0.0102083 + 0.015625, rtol=1e-5)
    # heading: the prior's 10^2 / 3 and a step's 7^2 square degrees
    assert np.degrees(np.degrees(own[4])) == pytest.approx(100 / 3 + 49, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("interval", [0.25, 4.0])
def test_the_agent_is_followed_whatever_the_time_between_steps(interval):
    data = gs.Scene.load("room").model_dump(exclude_none=True)
    own = {"interval_s": interval, "step_m": 0.05, "steps": 60, "acceleration_mps2": 1.0}
    data["agents"] = [data["agents"][0] | own]
    data["filter"] = {"particles": 512, "acceleration_mps2": 0.03 / interval**2}
    scene = gs.Scene.checked(data, "room")
    run, track = gs.map_scene(scene, gs.simulate(scene, "agent1", 1), seed=1), scene.track("agent1")
    gap = run.trajectory.position_m - track.position_m
    nees = np.einsum("ni,nij,nj->n", gap, np.linalg.inv(run.covariance[:, :2, :2]), gap)[20:]
    speed = np.linalg.norm(run.trajectory.velocity_mps - track.velocity_mps, axis=1)[20:]
    assert np.linalg.norm(gap, axis=1)[20:].max() < 0.1
    assert 0.5 < nees.mean() < 4.5
    assert np.sqrt((speed**2).mean()) < 0.8 * 0.05 / interval


def test_what_is_never_heard_fades_by_its_survival_alone_and_no_longer_than_a_ray_over_it_is_believed_in():
    """At 0 dB and a threshold of 20 dB nothing is ever detected, so silence says nothing: 0.9 x 0.99^N.

    A single bounce begins at 1/2, and is 1/11 + 9/22 x 0.945^k after k steps: below 0.35 from the ninth on.
    From then on a wall that was seen often stays; survival comes between steps, at the second to the eighth.
    """
    radio = {"snr_at_1m_db": 0.0, "detection_threshold_db": 20.0}
    scene = scene_of(radio=radio, filter={"survival": 0.99})
    for method in ("grid", "adaptive"):
        known = replace(gs.GridSlam(scene).map(), surfaces=wall(existence=0.9), surface_reflection=None)
        slam = method_class(method)(scene, prior_map=known)
        for step in range(31):
            slam.step(silence(float(step)))
        assert slam.state.surfaces.existence == pytest.approx([0.9 * 0.99**7], rel=1e-6)  # 0.83886


def test_evidence_and_coefficients_are_handed_over_as_they_are():
    scene = scene_of(radio={"snr_at_1m_db": 0.0, "detection_threshold_db": 20.0})
    draw, blank = np.random.default_rng(1), gs.GridSlam(scene).map()
    left = replace(
        blank, evidence=draw.uniform(-12, 12, blank.shape), observed=draw.random(blank.shape) < 0.5,
        coefficient=-draw.uniform(0, 12, (*blank.shape, len(REFLECTION_BINS))),
    )  # fmt: skip
    slam = gs.GridSlam(scene, prior_map=left)
    for grid in (slam.map(), (slam.step(silence()), slam.map())[1]):
        for name in ("evidence", "observed", "coefficient"):
            np.testing.assert_array_equal(getattr(grid, name), getattr(left, name))
    # and rays meet it, believed in to 9 to 1, L' = log((0.9 e^L + 0.1) / (0.1 e^L + 0.9)): a crossed cell is
    # occupied by 1 / (1 + exp(-(L' + log odds of the prior)))
    believed = np.log((0.9 * np.exp(left.evidence) + 0.1) / (0.1 * np.exp(left.evidence) + 0.9))
    odds = believed + np.log(left.prior / (1 - left.prior))
    expected = np.clip(1 / (1 + np.exp(-odds)), 1e-4, 0.99)
    cells = slam.work.require_cells()
    free, met = cells.clear.reshape(blank.shape) > 0, cells.occupancy(slam.state.require_grid())[0]
    np.testing.assert_allclose(met.reshape(blank.shape)[~free], expected[~free], rtol=1e-4)


def test_particles_keep_the_share_of_silvermans_rule():
    # 128^(-2/7) = 2^-2; 16384^(-2/7) = 2^-4
    slam = gs.GridSlam(scene_of())
    for count, kept in ((128, 0.25), (16384, 0.0625)):
        assert Particles(count, 0).ask(slam.state.belief) == (count, pytest.approx(kept))


@pytest.mark.parametrize("missing", [None, 1, 2], ids=["both angles", "no AoD", "no AoA"])
def test_births_of_one_measurement_equal_a_quadrature_over_all_lines(missing):
    """I = integral over lines (angle, offset) of births x f(distance, AoD, AoA, amplitude) over clutter.

    Lines are born uniformly over those that cross the region's circle, 2 pi R rad m of them (each line once),
    R = 7 sqrt(2) = 9.8995 m; clutter is 2 per scan, uniform over 60 m and both angles, and its amplitude
    has the density 2 u exp(-(u^2 - u_de^2)) above the threshold. What isn't measured has the density
    1 / 2 pi.
    """
    still = {"position_m": 0.0, "velocity_mps": 0.0, "heading_deg": 0.0}
    scene = scene_of(prior=still, filter={"births": 0.1, "particles": 512})
    z = np.array([8.55, np.radians(-20.0), np.radians(80.0)])  # near what a wall y = 6 would cause
    amplitude, at_1m, threshold = 3.0, 10**1.5, 10**0.3
    heard: list[np.ndarray | None] = [np.array([value]) for value in (*z, amplitude)]
    if missing is not None:
        heard[missing] = None
    scan = gs.Scan(0, 0.0, np.zeros(1, np.intp), *heard)
    slam = method_class("adaptive")(scene)
    slam.step(scan)
    (exchange,) = slam.info.exchanges
    born_over_clutter = exchange.measured[tables.NEW] - 1  # xi = 1 + I

    std = np.array([0.0389567, 0.106103, 0.106103])  # 116.87 mm / 3; 1 / (3 pi) rad
    angle = np.pi / 2 + np.linspace(-0.4, 0.4, 801)[:, None]
    offset = 6.0 + np.linspace(-1.5, 1.5, 801)[None]
    agent, facing, north = np.array([3.0, 4.0]), np.pi / 6, np.pi / 2
    normal = np.stack(np.broadcast_arrays(np.cos(angle), np.sin(angle)), -1)
    image = 2 * offset[..., None] * normal  # of the anchor, which is at the origin
    mirrored = agent + 2 * (offset - normal @ agent)[..., None] * normal
    back = image - agent
    distance = np.linalg.norm(back, axis=-1)
    aod = np.arctan2(mirrored[..., 1], mirrored[..., 0]) - north
    aoa = np.arctan2(back[..., 1], back[..., 0]) - facing
    gap = (np.stack([distance, aod, aoa], -1) - z) / std
    density = np.exp(-0.5 * gap**2) / (np.sqrt(2 * np.pi) * std)
    if missing is not None:
        density[..., missing] = 1 / (2 * np.pi)
    density = density.prod(-1)
    density *= offset > normal @ agent  # agent and anchor are on the same side
    area = 0.8 / 800 * 3.0 / 800
    born = 0.1 / (2 * np.pi * 7 * np.sqrt(2))
    level = at_1m / z[0] * (np.arange(20) + 0.5) / 20
    rice = np.mean(np.exp(scene.signal_model("me").log_rician(amplitude, level)))
    clutter = 2.0 / (60 * (2 * np.pi) ** 2) * 2 * amplitude * np.exp(-(amplitude**2 - threshold**2))
    expected = born * density.sum() * area * rice / clutter
    # 256 samples of distance and AoA, of which about a third count: within a tenth
    assert born_over_clutter == pytest.approx([expected], rel=0.1)
