"""What an agent's antenna elements and the pulse really are, from a recording along a known way."""

from __future__ import annotations

import numpy as np

from gridslam import runtime
from gridslam.errors import InputError
from gridslam.inference.management.features.surface_features import image_features
from gridslam.inference.messages.features.radio_errors import Known, RadioErrors, radio_errors
from gridslam.maps.feature_rows import of_anchor, places_and_lengths
from gridslam.maps.frames import fitted, refuse_lost
from gridslam.maps.map import Map
from gridslam.measurements.recording import Recording
from gridslam.world.scene import Scene
from gridslam.world.signal_model import SignalModel

LEAST_STEPS = 10


def calibrate(
    scene: Scene,
    recording: Recording,
    prior_map: Map | None = None,
    agent: str | None = None,
    same_frame: bool = False,
) -> RadioErrors:
    """Errors of an agent's elements and of the pulse, see docs/model.md, (M234), (M235).

    Parameters
    ----------
    scene : Scene
        Its anchors; of one antenna each.
    recording : Recording
        With the true track, which is taken as exact.
    prior_map : Map, optional
        Whose learned features, else surfaces, are heard beside the lines of sight.
    agent : str, optional
        Default: the scene's first.
    same_frame : bool
        The user's word that `prior_map` is in the scene's frame, where nothing in it tells so.

    Returns
    -------
    RadioErrors
        Where the agent's N elements stand and what the pulse's M frequencies have, with deviations.

    Raises
    ------
    InputError
        No true track, fewer than 10 steps, other anchors or ones of several antennas, or a map of another
        frame or of a lost agent.
    """
    track, wave, steps = recording.truth, recording.waveform, len(recording.samples)
    if track is None:
        raise InputError("calibrate: recording", "no true track", "one along a known way")
    if steps < LEAST_STEPS:
        raise InputError("calibrate: recording", f"{steps} steps", f"{LEAST_STEPS} or more")
    if wave.anchor_element_m.shape[1] != 1 or len(wave.anchor_element_m) != len(scene.anchors):
        found = f"{len(wave.anchor_element_m)} anchors of {wave.anchor_element_m.shape[1]} elements"
        raise InputError("calibrate: recording", found, f"{len(scene.anchors)} anchors of one")
    heading = track.heading_rad if recording.heading_rad is None else recording.heading_rad
    pose = np.column_stack([track.position_m, heading])[:steps]
    model = SignalModel.of(scene.filter_model(agent), wave)
    table = None
    if prior_map is not None:
        refuse_lost([prior_map], ["calibrate: map"])
        prior, _ = fitted(prior_map, scene, same_frame=same_frame)
        table = prior.features
        if table is None or not len(table):
            table, *_ = image_features(prior.surfaces, prior.surface_covariance, model)
    known = []
    for j, anchor in enumerate(model.anchors[:, :2]):
        paths = np.array([[*anchor, 0.0]])
        if table is not None:
            paths = np.concatenate([paths, places_and_lengths(table)[of_anchor(table, anchor)]])
        received = recording.heard[:, j]
        if received.any():
            samples = np.asarray(recording.samples[received, j, 0], np.complex128)
            known.append(Known(samples, pose[received], paths))
    with runtime.one_blas_thread():
        return radio_errors(known, wave)
