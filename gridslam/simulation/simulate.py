"""The door to simulation: what an agent would hear, as paths or as samples."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, overload

from gridslam.errors import InputError
from gridslam.measurements.network import NetworkMeasurements
from gridslam.measurements.observations import Observations
from gridslam.measurements.recording import Recording
from gridslam.measurements.table import Measurements
from gridslam.simulation import image_source, network
from gridslam.simulation.samples import simulate_samples
from gridslam.world.observation import Kind
from gridslam.world.scene import Scene
from gridslam.world.start import only_agent, require_scene

Names = list[str] | tuple[str, ...]


def observations_of(scene: Scene, agent: str, seed: int, takes: Kind) -> Observations:
    """What an agent hears on its track, of the kind that a method takes."""
    return (
        simulate_samples(scene, agent, seed)
        if takes == "signal"
        else image_source.simulate(scene, agent, seed)
    )


@overload
def simulate(scene: Scene, agent: str | None = None, seed: int = 0) -> Measurements: ...
@overload
def simulate(scene: Scene, agent: Names, seed: int = 0, unlabelled: bool = False) -> NetworkMeasurements: ...
@overload
def simulate(
    scene: Scene, agent: str | None = None, seed: int = 0, *, what: Literal["signal"]
) -> Recording: ...
def simulate(
    scene: Scene,
    agent: str | Names | None = None,
    seed: int = 0,
    unlabelled: bool = False,
    what: str = "paths",
) -> Measurements | NetworkMeasurements | Recording:
    """What one agent hears on its track, or several: detected paths with noise and clutter, or samples.

    Paths by image sources [Borish1984image]; measurements of them by docs/model.md, (M9)-(M13), samples by
    (M49)-(M51).

    Parameters
    ----------
    scene : Scene
        With walls; for signals, with ``radio.frequencies`` and ``radio.frequency_step_hz``.
    agent : str or sequence of str, optional
        One agent's name gives `Measurements` (or a `Recording`), a list of names `NetworkMeasurements`.
        Default: the scene's only agent.
    seed : int
    unlabelled : bool
        Of several agents: nothing says whose a measurement is, and ``radio.false_alarms`` counts the clutter
        of all anchors together.
    what : "paths" or "signal"
        Signals are those of one agent.

    Raises
    ------
    InputError
        No scene or such agent, none named of several, one without waypoints, several whose steps take
        different times, or a scene that samples no signals.

    Examples
    --------
    >>> import gridslam as gs
    >>> heard = gs.simulate(gs.Scene.load("room"), "agent1", seed=1)
    >>> heard.anchors
    ('A', 'B')
    >>> gs.simulate(gs.Scene.load("screen"), "agent1", seed=1, what="signal").samples.shape
    (190, 1, 1, 4, 81)
    """
    require_scene(scene)
    agent = only_agent(scene) if agent is None else agent
    if not isinstance(agent, Sequence):
        raise InputError("agent", repr(agent), "an agent's name, or a list of names")
    if what == "signal":
        if not isinstance(agent, str):
            raise InputError("agent", repr(list(agent)), "one agent's name: a recording is one agent's")
        return simulate_samples(scene, agent, seed)
    if what != "paths":
        raise InputError("what", repr(what), "'paths' or 'signal'")
    if isinstance(agent, str):
        return network.simulate(scene, agent, seed)
    return network.simulate(scene, agent, seed, unlabelled)
