"""Where an agent is told to start: exactly where it does, or as well as its prior says."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, get_args

import numpy as np
from pydantic_core import PydanticCustomError

from gridslam.arrays import Array
from gridslam.errors import InputError
from gridslam.world.geometry import wrap
from gridslam.world.levels import COEFFICIENTS, check_heights
from gridslam.world.scene import Scene

Asked = Literal["drawn", "exact"]
HOWS: tuple[Asked, ...] = get_args(Asked)
How = Literal["drawn", "exact", "scene", "told"]
STREAM = 0x57
MOST_DRAWS = 100
"""Draws of heights before the scene's own are taken, which stand in order."""


@dataclass(frozen=True, eq=False)
class Start:
    """What a filter is told of its agent's start.

    Attributes
    ----------
    position_m : (2,) float64, m
    heading_rad : float
    how : str
        "drawn" from the prior, "exact": a simulated agent's true one, "scene": the scene's own, as its author
        wrote it, where nobody knows how exact it is; or "told" by the user.
    heights_m : dict
        Heights (m) that it is told other than the scene's: of "agent", "floor", "ceiling".
    coefficients : dict
        The same of coefficients, of "floor" and "ceiling".
    """

    position_m: Array
    heading_rad: float
    how: How = "told"
    heights_m: dict[str, float] = field(default_factory=dict)
    coefficients: dict[str, float] = field(default_factory=dict)


def require_seed(seed: int) -> None:
    """Refuse what random numbers can't follow from.

    Raises
    ------
    InputError
        Not a whole number from 0 on.
    """
    if not isinstance(seed, int | np.integer) or seed < 0:
        raise InputError("seed", repr(seed), "a whole number, 0 or more")


def only_agent(scene: Scene) -> str:
    """Name of a scene's only agent, for calls that name none.

    Raises
    ------
    InputError
        It has none, or several.
    """
    names = [agent.name for agent in scene.agents]
    if len(names) != 1:
        found = "none named, of several" if names else f"none in scene {scene.name}"
        raise InputError("agent", found, ", ".join(map(repr, names)) or "a scene with [[agents]]")
    return names[0]


def require_scene(scene: object) -> None:
    """Refuse what is no scene, its name above all.

    Raises
    ------
    InputError
    """
    if not isinstance(scene, Scene):
        raise InputError("scene", type(scene).__name__, "a Scene, as gs.Scene.load(name or path) returns")


def start_of(
    scene: Scene, agent: str, seed: int, asked: Start | Sequence[float] | str | None, simulated: bool
) -> Start:
    """The start that a run takes: as `asked`, else drawn where all is simulated, and the scene's where not.

    Raises
    ------
    InputError
        As `assumed_start`, or `asked` is no pose of three finite numbers.
    """
    if isinstance(asked, Start):
        return asked
    if asked is None and not simulated:
        return replace(assumed_start(scene, agent, seed, "exact"), how="scene")
    if asked is None or isinstance(asked, str):
        return assumed_start(scene, agent, seed, asked or "drawn")
    pose = np.array(asked, dtype=object).ravel()
    known = len(pose) == 3 and all(isinstance(one, int | float | np.number) for one in pose)
    if not known or not np.isfinite(pose.astype(np.float64)).all():
        raise InputError("start", repr(asked), f"{' or '.join(HOWS)}, or a pose (x m, y m, heading rad)")
    x_m, y_m, heading_rad = map(float, pose)
    return Start(np.array([x_m, y_m]), heading_rad)


def assumed_start(scene: Scene, agent: str, seed: int, how: str = "drawn") -> Start:
    """The start that a filter assumes for an agent of the scene.

    Parameters
    ----------
    how : str
        "drawn": uniform about the first pose of the agent's track (of an agent without waypoints, about
        its `start_m`), within the half widths of its prior and the region; the same for the same seed,
        whatever is heard; so are heights and coefficients with deviations, normally distributed. "exact": the
        scene's own.

    Raises
    ------
    InputError
        There is no such agent, `how` is neither, or the seed is negative.
    """
    if how not in HOWS:
        raise InputError("start", repr(how), " or ".join(HOWS))
    body = scene.agent(agent)
    place, heading = np.array(body.start_m, dtype=np.float64), float(np.radians(body.start_heading_deg))
    if how == "exact":
        return Start(place, heading, "exact")
    if body.waypoints_m is not None:
        track = scene.track(agent)
        place, heading = track.position_m[0], float(track.heading_rad[0])
    require_seed(seed)
    draw = np.random.default_rng([seed, scene.agents.index(body), STREAM])
    low, high = np.transpose([scene.grid.x_m, scene.grid.y_m])
    off = body.prior.position_m * draw.uniform(-1, 1, 2)
    turn = np.radians(body.prior.heading_deg) * draw.uniform(-1, 1)
    heights, coefficients = _drawn_heights(scene, agent, draw), _drawn_coefficients(scene, draw)
    return Start(np.clip(place + off, low, high), float(wrap(heading + turn)), "drawn", heights, coefficients)


def _drawn_coefficients(scene: Scene, draw: np.random.Generator) -> dict[str, float]:
    """Coefficients of floor and ceiling from their priors, as far as they can be such."""
    stated = {name: (one.coefficient, one.coefficient_std) for name, one in scene.levels.items()}
    return {
        name: float(np.clip(known + std * draw.standard_normal(), COEFFICIENTS[0], COEFFICIENTS[-1]))
        for name, (known, std) in stated.items()
        if std > 0
    }


def _drawn_heights(scene: Scene, agent: str, draw: np.random.Generator) -> dict[str, float]:
    """Heights (m) from their priors, such that anchors and agents stay between floor and ceiling."""
    stated = scene.uncertain_heights(agent)
    for _ in range(MOST_DRAWS):
        heights = {name: known + std * float(draw.standard_normal()) for name, (known, std) in stated.items()}
        other = scene.at_heights(agent, heights)
        try:
            check_heights(other.anchors, other.agents, other.floor, other.ceiling)
        except PydanticCustomError:
            continue
        return heights
    return {name: known for name, (known, _) in stated.items()}
