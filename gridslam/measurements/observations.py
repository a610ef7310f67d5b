"""What an agent heard, of either kind: measured paths or sampled signals."""

from __future__ import annotations

from pathlib import Path

from gridslam.errors import InputError
from gridslam.measurements.network import NetworkMeasurements
from gridslam.measurements.recording import Recording
from gridslam.measurements.table import Measurements
from gridslam.world.observation import Kind

Observations = Measurements | Recording
NAMES: dict[Kind, str] = {"paths": "measurements.h5", "signal": "signal.h5"}
"""Names of their files in folders of runs."""


def kind_of(observations: Observations) -> Kind:
    """Which of the two it is."""
    return "signal" if isinstance(observations, Recording) else "paths"


def read_observations(folder: Path, prefix: str = "") -> Observations:
    """Read what a folder has of the two.

    Raises
    ------
    InputError
        It has neither, or that file can't be read.
    """
    signal = folder / f"{prefix}{NAMES['signal']}"
    return (
        Recording.from_h5(signal)
        if signal.exists()
        else Measurements.from_h5(folder / f"{prefix}{NAMES['paths']}")
    )


def require_kind(observations: object, takes: Kind, method: str) -> None:
    """Refuse what a method doesn't take.

    Raises
    ------
    InputError
        Samples for a method on paths, or the other way round, or neither.
    """
    if isinstance(observations, Recording) and takes != "signal":
        allowed = "path measurements: gridslam extract (gs.extract) makes them of signals"
        raise InputError(f"method {method!r}", "sampled signals", allowed)
    if isinstance(observations, Measurements) and takes == "signal":
        raise InputError(f"method {method!r}", "path measurements", "sampled signals, a Recording (--signal)")
    if isinstance(observations, NetworkMeasurements):
        raise InputError("measurements", "those of several agents", "one agent's (several: gs.map_network)")
    if not isinstance(observations, Measurements | Recording):
        raise InputError("measurements", type(observations).__name__, "Measurements or a Recording")
