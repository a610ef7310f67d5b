"""gridslam: radio multipath in, a map out."""

from gridslam.errors import InputError
from gridslam.estimate_tables import PathEstimate, SurfaceEstimate
from gridslam.estimates import Estimate
from gridslam.evaluation.scene_bound import bound
from gridslam.extraction.front_end import extract
from gridslam.importers.deepmimo import measurements_from_deepmimo as from_deepmimo
from gridslam.importers.deepmimo import network_from_deepmimo
from gridslam.importers.sionna import measurements_from_sionna as from_sionna
from gridslam.importers.sionna import network_from_sionna
from gridslam.importers.sionna_samples import recording_from_sionna
from gridslam.inference.messages.features.radio_errors import RadioErrors
from gridslam.maps.fusion import fuse
from gridslam.maps.map import Map
from gridslam.measurements.network import NetworkMeasurements
from gridslam.measurements.recording import Recording
from gridslam.measurements.table import Measurements, Scan
from gridslam.runs.calibrate import calibrate
from gridslam.runs.heard_stretches import map_so_far
from gridslam.runs.map_scene import map_scene
from gridslam.runs.network_run import NetworkRun, map_network
from gridslam.runs.run import Run
from gridslam.simulation.image_source import Truth, ground_truth
from gridslam.simulation.simulate import simulate
from gridslam.systems.adaptive import AdaptiveSlam
from gridslam.systems.direct import DirectSlam
from gridslam.systems.direct_grid import DirectGridSlam
from gridslam.systems.grid import GridSlam
from gridslam.systems.hybrid import HybridSlam
from gridslam.systems.network import NetworkSlam
from gridslam.systems.network_grid import NetworkGridSlam
from gridslam.systems.slam import Slam
from gridslam.systems.virtual_anchor import VirtualAnchorSlam
from gridslam.world.network_scan import NetworkScan
from gridslam.world.scene import Scene
from gridslam.world.scene_files import bundled_scenes
from gridslam.world.signal_scan import SignalScan
from gridslam.world.trajectory import Trajectory
from gridslam.world.waveform import Waveform

__version__: str
__all__ = [
    "AdaptiveSlam",
    "DirectGridSlam",
    "DirectSlam",
    "Estimate",
    "GridSlam",
    "HybridSlam",
    "InputError",
    "Map",
    "Measurements",
    "NetworkGridSlam",
    "NetworkMeasurements",
    "NetworkRun",
    "NetworkScan",
    "NetworkSlam",
    "PathEstimate",
    "RadioErrors",
    "Recording",
    "Run",
    "Scan",
    "Scene",
    "SignalScan",
    "Slam",
    "SurfaceEstimate",
    "Trajectory",
    "Truth",
    "VirtualAnchorSlam",
    "Waveform",
    "bound",
    "bundled_scenes",
    "calibrate",
    "extract",
    "from_deepmimo",
    "from_sionna",
    "fuse",
    "ground_truth",
    "map_network",
    "map_scene",
    "map_so_far",
    "network_from_deepmimo",
    "network_from_sionna",
    "recording_from_sionna",
    "simulate",
]
