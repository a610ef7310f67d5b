"""What no filter can beat in a scene, by one name."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gridslam.errors import InputError
from gridslam.evaluation.array_bounds import array_bound
from gridslam.evaluation.bounds import Bound, known_map_bound, unknown_map_bound
from gridslam.evaluation.ground_truth import tells_heading, walls_tell_all
from gridslam.evaluation.signal_bounds import has_single_antennas, scene_signal_bound
from gridslam.simulation.image_source import only_agent
from gridslam.world.observation import Kind
from gridslam.world.scene import Scene
from gridslam.world.start import require_scene


def bound(scene: Scene, agent: str | None = None, known_map: bool = True, what: Kind = "paths") -> Bound:
    """Cramér-Rao bound of an agent along the way that the scene gives it: no run, no measurements.

    As in tables of `run` (the map is known) and `study` (both): [Tichavsky1998pcrb]; docs/model.md, (M47).

    Parameters
    ----------
    scene : Scene
        With walls, else lines of sight alone tell of the place.
    agent : str, optional
        May be left out of a scene of one agent.
    known_map : bool
        Whether the walls are known; else they are found on the way.
    what : "paths" or "signal"
        What is heard: measured paths, or sampled signals, of which the bound prices overlap in.

    Returns
    -------
    Bound
        ``position_m`` and ``heading_rad``, (N,) float64: root mean square errors at each step, in m and
        rad, that none beats on average; headings NaN where nothing that is heard tells them. Clocks are
        taken as known.

    Raises
    ------
    InputError
        No such agent, one without a way, another kind, samples that the scene says nothing of, or samples
        that scatterers are heard in, too, which bounds don't count.
    """
    require_scene(scene)
    name = only_agent(scene) if agent is None else agent
    scene.agent(name)
    if what not in ("paths", "signal"):
        raise InputError("what", repr(what), "'paths' or 'signal'")
    if what == "paths":
        found = known_map_bound(scene, name) if known_map else unknown_map_bound(scene, name)
        if tells_heading(scene, name, what):
            return found
        return replace(found, heading_rad=np.full(len(found.heading_rad), np.nan))
    if not walls_tell_all(scene, what):
        raise InputError(
            f"{scene.name}: scatterers", "some", "none, or what='paths': bounds count walls alone"
        )
    single = has_single_antennas(scene, name)
    return (scene_signal_bound if single else array_bound)(scene, name, known_map)
