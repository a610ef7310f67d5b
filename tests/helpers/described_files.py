"""A file of every described kind that holds all that is described, made by hand and written as runs do."""

from dataclasses import replace

import numpy as np
from map_samples import random_map
from run_samples import some_estimate

import gridslam as gs
from gridslam.estimate_tables import FeatureEstimate, SurfaceStretches
from gridslam.io.datasets import Layout
from gridslam.maps.map_anchors import MapAnchors
from gridslam.maps.map_cells import joint_of
from gridslam.maps.map_datasets import MAP
from gridslam.measurements.datasets import MEASUREMENTS, RECORDING
from gridslam.measurements.network import NetworkMeasurements
from gridslam.measurements.simulated import Simulated
from gridslam.measurements.table import Measurements
from gridslam.runs.clock_track import ClockTrack
from gridslam.runs.network_files import CLOCKS, read_clocks, write_clocks
from gridslam.runs.step_datasets import ALL_STEPS
from gridslam.runs.step_files import read_steps, write_steps
from gridslam.world.clocks import ClockTruth
from gridslam.world.columns import OPTIONAL
from gridslam.world.levels import COEFFICIENTS
from gridslam.world.trajectory import Trajectory

TRACK = Trajectory([0.0, 0.5], [[1, 2], [3, 4]], [[0, 1], [1, 0]], [0.1, 0.2], [1.0, 1.1], [[0.1, 0.4]])
SIMULATED = Simulated("room", ("me", "you"), 3)


def measured(path):
    """Two agents' rows, with all columns."""
    half = np.full(4, 0.5)
    table = Measurements(
        anchors=("A", "B"), step=np.array([0, 0, 2, 3]), time_s=np.array([0, 0, 1, 1.5]),
        anchor=np.array([-1, 1, 0, -1]), distance_m=half, aod_rad=half, aoa_rad=half, amplitude=half,
        **{name: half for name in OPTIONAL}, anchor_position_m=np.ones((2, 3)),
        anchor_orientation_rad=np.zeros(2), steps=5, interval_s=0.5, unlabelled=True, pseudo=True,
        simulated=SIMULATED,
    )  # fmt: skip
    clocks = ClockTruth(("A", "B", "me", "you"), np.array([0.0, 0.5]), np.arange(8).reshape(2, 4) * 1e-9)
    tracks = {"me": TRACK, "you": TRACK}
    NetworkMeasurements(
        ("me", "you"), table, np.array([0, 1, 0, 1]), np.array([[0, 4], [0, 4]]), tracks, clocks
    ).to_h5(path)


def measured_by_one(path):
    """One agent's rows, its true track, and nothing that needn't be there."""
    half = np.full(3, 0.5)
    Measurements(
        anchors=("A",), step=np.arange(3), time_s=np.arange(3.0), anchor=np.zeros(3, int), distance_m=half,
        aod_rad=half, aoa_rad=half, amplitude=half, truth=TRACK,
    ).to_h5(path)  # fmt: skip


def mapped(path):
    """Cells, surfaces with stretches, features, anchors and levels."""
    plain = random_map(1, lines=((0.3, 2.0), (1.8, 3.0)))
    one, whole, spread = np.ones(2), np.arange(2), np.tile(np.eye(4), (2, 1, 1))
    learned = FeatureEstimate(whole, whole, *2 * [np.ones((2, 2))], *3 * [one], spread, *3 * [whole])
    agents = {
        "agents": ["a", "b"],
        "seeds": [1, 2],
        "steps": [7, 8],
        "runs": ["12", "34"],
        "kinds": ["paths", "signal"],
        "told": ["walls"],
    }
    anchors = {"anchors": ["A", "B"], "anchor_x_m": [0.0, 1.0], "anchor_y_m": [1.0, 0.0]}
    stand = MapAnchors(("A", "B"), np.ones((2, 2)), one, np.eye(6), np.zeros((6, 4)))
    even = np.full(len(COEFFICIENTS), 1 / len(COEFFICIENTS))
    replace(
        plain, features=learned, feature_covariance=np.eye(6), levels={"floor": even, "ceiling": even},
        surface_covariance=joint_of(plain.surfaces.line_cov), provenance=agents | anchors | {"lost": ["a"]},
        anchors=stand,
        stretches=SurfaceStretches(np.array([0, 0, 1]), np.array([[0.0, 1.0], [2.0, 3.0], [0.0, 1.0]])),
    ).save(path)  # fmt: skip


def estimated(path):
    """Steps with rows of all kinds, heights and coefficients."""
    levels = {"floor": (0.2, 0.1), "ceiling": (0.5, 0.1)}
    steps = [some_estimate(*sizes) for sizes in ((0, 0, 0), (1, 3, 2), (2, 0, 5), (3, 2, 0))]
    steps = [replace(one, heights=levels | {"agent": (1.0, 0.1)}, coefficients=levels) for one in steps]
    write_steps(path, steps)


def recorded(path):
    """Samples of arrays, with headings."""
    draw = np.random.default_rng(0)
    elements = 0.02 * np.array([[-1.0, 0.0], [1.0, 0.0]])
    recording = gs.Recording.from_arrays(
        draw.normal(size=(2, 1, 2, 2, 8)) + 1j, 6e9, 1e7 * (np.arange(8) - 3.5), ["A"],
        pulse=np.ones(8), anchor_element_m=elements[None], agent_element_m=elements, noise_std=[0.1],
        heading_std_rad=0.01, heading_rad=[0.0, 0.1], anchor_position_m=[[0.0, 0.0]],
        anchor_orientation_rad=[0.0], truth=TRACK,
    )  # fmt: skip
    replace(recording, simulated=SIMULATED).to_h5(path)


def timed(path):
    """Offsets of an anchor's and an agent's clock."""
    time, offsets = np.array([0.0, 1.0]), np.array([[0.0, 0.0], [1e-9, 3e-9]])
    spread = np.zeros((2, 2, 2))
    track = ClockTrack(("A", "me"), 1, np.arange(2), time, offsets, spread, np.zeros((2, 1), bool))
    write_clocks(path, track, ClockTruth(("A", "me"), time, offsets))


FILES = {
    "measurements": (MEASUREMENTS, measured, gs.NetworkMeasurements.from_h5),
    "measurements of one": (MEASUREMENTS, measured_by_one, gs.Measurements.from_h5),
    "map": (MAP, mapped, gs.Map.load),
    "steps": (ALL_STEPS, estimated, read_steps),
    "signal": (RECORDING, recorded, gs.Recording.from_h5),
    "clocks": (CLOCKS, timed, read_clocks),
}
"""By name: what is described, and how a file of it is written and read."""
LAYOUTS: dict[str, Layout] = {name: layout for name, (layout, _, _) in FILES.items()}


def write_all(folder):
    """A file of every kind in a folder, called after its kind."""
    for name, (_, write, _) in FILES.items():
        write(folder / f"{name}.h5")
    return folder
