"""What is in a file of several agents' measurements, and whether a scene fits it."""

from __future__ import annotations

import os
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import h5py
import numpy as np

from gridslam.checks.network.devices import device_lines, devices
from gridslam.checks.network.labels import (
    Judged,
    judge_labels,
    late_agents,
    suspicion_lines,
    untold_lines,
    widest_offset_m,
)
from gridslam.checks.scene.range_words import clocks_advice
from gridslam.checks.tables.repeats import repeats_line
from gridslam.checks.verdicts.diagnose import HELD_OFFSETS
from gridslam.errors import InputError, located
from gridslam.io.files import reading_h5
from gridslam.measurements import csv_table, hdf5_table, matlab
from gridslam.measurements.network import NetworkMeasurements
from gridslam.runs.network_run import check_names
from gridslam.wording import counted
from gridslam.world.columns import require_distances
from gridslam.world.network_scene import clocks_are_known
from gridslam.world.scene import Scene

UNLABELLED = (
    "--method network and network_grid find out which, by a scene with all anchors and each agent's start "
    "(and [clocks], where nobody set them), and a column agent where there are several"
)


def is_network(path: str | os.PathLike[str], scene: Scene | None = None) -> bool:
    """Whether a file of measurements has several agents, or rows that don't say whose they are.

    Nor is a table without a column of agents one agent's where the scene has several and unknown clocks.

    Raises
    ------
    InputError
        It can't be read at all.
    """
    names = [agent.name for agent in scene.agents] if scene is not None else []
    shared = scene is not None and len(names) > 1 and not clocks_are_known(scene, names)
    if Path(path).suffix.lower() == ".mat":
        return shared or matlab.names_agents(path)
    if Path(path).suffix.lower() != ".csv":
        with reading_h5(path, hdf5_table.KIND, hdf5_table.VERSIONS) as file:
            return "agents" in file or bool(_flag(file))
    try:
        with Path(path).open(encoding="utf-8-sig") as text:
            header = [csv_table.column_name(name) for name in text.readline().replace(";", ",").split(",")]
    except (OSError, UnicodeDecodeError):
        return False  # the reader says what is wrong
    return shared or "agent" in header or ("step" in header and "anchor" not in header)


def describe_network(path: str | os.PathLike[str], scene: Scene | None = None) -> list[str]:
    """Say what a file of several agents holds, in units, and what looks wrong with it.

    Parameters
    ----------
    path : path
    scene : Scene, optional
        Names of agents and anchors; whether it has clocks.

    Returns
    -------
    list of str
        Lines for a person; those of suspicions start with ``suspect:``, others that
        alarm with ``unsure:``.

    Raises
    ------
    InputError
        Any fault of the file, or agents and anchors that aren't the scene's.
    """
    measurements = _read(path, scene)
    table, named = measurements.table, measurements.table.anchor >= 0
    with located(path):
        require_distances(table.columns)
    low, high = np.nanmin(table.distance_m), np.nanmax(table.distance_m)
    negative = int((table.distance_m < 0).sum())
    lines = [
        f"measurements: {counted(len(measurements), 'step')}, {counted(len(table.step), 'path')} of "
        f"{counted(len(measurements.agents), 'agent')}, anchors {', '.join(table.anchors)}",
        f"  labels: {named.mean():.0%} of the rows say which anchor they are of",
        f"  distance_m: {low:.3g} to {high:.3g}, {negative} negative",
    ]
    for index, name in enumerate(measurements.agents):
        first, last = np.asarray(measurements.present)[index]
        count = int((measurements.agent == index).sum())
        silent = last - first + 1 - len(np.unique(table.step[measurements.agent == index]))
        mean = count / (last - first + 1)
        lines.append(
            f"  {name}: steps {first} to {last}, {mean:.1f} paths a step, "
            f"{counted(silent, 'step')} of silence"
        )
    if table.simulated is not None:
        lines.append(f"  simulated: {table.simulated}")
    if repeated := repeats_line(table.columns, measurements.agent):
        lines.append(f"suspect: {repeated}")
    judged = judge_labels(measurements, scene) if scene is not None else []
    least_m = -float(low) if negative and scene is not None and scene.clocks is None else 0.0
    if least_m and scene is not None:
        advice = clocks_advice(max(least_m, widest_offset_m(judged, scene)))
        lines.append(f"suspect: negative distances hold offsets of clocks, {-low:.3g} m at least: {advice}")
    if 0 < named.mean() < 1:
        share = f"{1 - named.mean():.0%}"
        lines.append(
            f"suspect: labels are missing on {share} of the rows: clutter of all anchors counts once"
        )
    if scene is not None and not named.any() and _one_by_one(measurements, scene):
        lines.append(
            "suspect: anchor: no row says which anchor it is of, and the scene has no [clocks]: `run` "
            "refuses it; give it a column anchor, or take --method network or network_grid, which need none"
        )
    if scene is not None:
        absent = [
            body.name for body in scene.agents if body.present_s and body.name not in measurements.agents
        ]
        lines += [f"suspect: agent {name} should be there and has no row" for name in absent]
        lines += _against_scene(measurements, scene, judged, least_m)
    if not named.any():
        lines.append(f"  no row says which anchor it is of: {UNLABELLED}")
    elif not named.all() or len(measurements.agents) > 1:
        lines.append("  for --method network or network_grid")
    return lines


def judged_by_angles(
    lines: list[str], path: str | os.PathLike[str], scene: Scene | None, agent: str | None
) -> list[str]:
    """Lines of `diagnose.describe` about one agent's table; by its angles where clocks hide lengths.

    Parameters
    ----------
    lines : list of str
    path, scene, agent
        As of `diagnose.describe`.
    """
    held = [line for line in lines if line.startswith(HELD_OFFSETS)]
    if scene is None or not held or not scene.agents or any(line.startswith("refused: ") for line in lines):
        return lines
    name = agent if agent is not None else scene.agents[0].name
    with suppress(InputError):  # whoever reads the file is told
        measurements = NetworkMeasurements.load(path, scene.anchor_names, [name], pseudo=True)
        judged = judge_labels(measurements, scene)
        return [line for line in lines if line not in held] + _against_scene(measurements, scene, judged)
    return lines


def _against_scene(
    measurements: NetworkMeasurements, scene: Scene, judged: Sequence[Judged], least_m: float = 0.0
) -> list[str]:
    """What labels and clocks show, and what each agent's labelled rows do by themselves.

    Where offsets of clocks are in distances, they aren't suspected of anything else.
    """
    late = late_agents(judged, scene)
    if scene.clocks is None:
        late += [name for name in measurements.agents if (measurements[name].distance_m < 0).any()]
    own = devices(measurements, scene, late)
    accused = [one.agent for one in judged if suspicion_lines([one], scene)]
    few = untold_lines(judged, [device.agent for device in own])
    return [*few, *suspicion_lines(judged, scene, least_m), *device_lines(own, accused)]


def _one_by_one(measurements: NetworkMeasurements, scene: Scene) -> bool:
    """Whether a table is for methods of one agent, which know the anchors of its rows, as far as it goes."""
    simulated = measurements.table.simulated is not None  # so it was asked for
    return len(measurements.agents) == 1 and scene.clocks is None and not simulated


def _read(path: str | os.PathLike[str], scene: Scene | None) -> NetworkMeasurements:
    if scene is not None:
        agents = [agent.name for agent in scene.agents]
        measurements = NetworkMeasurements.load(path, scene.anchor_names, agents, pseudo=True)
        with located(path):
            check_names(scene, measurements)
        return measurements
    kind = Path(path).suffix.lower()
    if kind not in (".csv", ".mat"):
        return NetworkMeasurements.from_h5(path)
    if kind == ".csv":
        anchors = csv_table.read_csv(path, None, checked=False, pseudo=True, several=True, alone="agent")[1]
    else:
        anchors = matlab.read_network_mat(path, checked=False)[1]
    if not anchors:
        allowed = f"--scene SCENE, which names them; {UNLABELLED}"
        raise InputError(str(path), "no row that names an anchor", allowed)
    return NetworkMeasurements.load(path, anchors, None, pseudo=True)


def _flag(file: h5py.File) -> object:
    rows = file.get("measurements")
    return rows.attrs.get("unlabelled", False) if isinstance(rows, h5py.Group) else False
