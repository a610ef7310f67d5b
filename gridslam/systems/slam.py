"""What a method is: scans in, estimates and a map out. The contract of our systems and of anybody's own."""

from __future__ import annotations

import inspect
from typing import Any, Protocol, cast, runtime_checkable

import numpy as np

from gridslam.errors import InputError
from gridslam.estimates import Estimate
from gridslam.maps.map import Map
from gridslam.world.observation import Observation
from gridslam.world.scan import Scan
from gridslam.world.scene import Scene
from gridslam.world.waveform import Waveform

POSE = "position_m", "velocity_mps", "heading_rad"
CONSTRUCTOR = "one that takes (scene, prior_map=None, agent=None, seed=0)"


@runtime_checkable
class Slam(Protocol):
    """A method of SLAM, one step at a time. A class needs no base: it has these members, or it doesn't fit.

    ``map_scene(method=MyClass)`` and ``--method package.module:MyClass`` take any such class, and packages
    may enter theirs under a name of their own (entry points of the group ``gridslam.methods``).

    Parameters
    ----------
    scene : Scene
        Radio, anchors, region, filter settings, agents. What a filter may know of it is
        ``scene.filter_model(agent)``; walls and waypoints are the truth and are not to be read.
    prior_map : Map, optional
        What an earlier agent left, on the scene's grid and in its frame.
    agent : str, optional
        Which of the scene's agents. Default: the first.
    seed : int
        Of all random numbers: equal seeds are to give equal numbers.

    Attributes
    ----------
    agent : str
        Whom it follows.

    Notes
    -----
    A constructor may also take ``same_frame=False``, the user's word that `prior_map` is in the scene's
    frame; `map_scene` vouches for that itself and never passes it. A method that has
    ``start_at(position_m, heading_rad)`` is told by it where the agent starts, (2,) m and rad; of any other
    method, the scene's agent starts there.

    A class with ``takes = "signal"`` is handed sampled signals, a `SignalScan` a step; its constructor takes
    ``waveform=None``, too: the `Waveform` of the recording.
    """

    agent: str

    def __init__(
        self, scene: Scene, prior_map: Map | None = None, agent: str | None = None, seed: int = 0
    ) -> None: ...

    def step(self, scan: Scan) -> Estimate:
        """Take in what was heard at one step and return what is believed now.

        Parameters
        ----------
        scan : Scan
            M measurements (0 if nothing was heard), columns (M,): index of the anchor, distance (m), angles
            (rad, relative to the anchor's orientation and to the heading), amplitude; NaN: not measured.

        Returns
        -------
        Estimate
            Of this step and time: position (2,) m, velocity (2,) m/s, heading (rad) and their covariance
            (5, 5); surfaces and paths where the method knows any. `Estimate.of_pose` makes one of
            position, heading and covariance alone.
        """
        ...

    def map(self) -> Map:
        """The map as it stands; ``Map.of_scene(scene)``, blank, of a method that maps nothing."""
        ...


def require_slam(found: object, where: str, name: str) -> type[Slam]:
    """Pass a class that can be a method, by its members and its constructor's arguments.

    Raises
    ------
    InputError
        It isn't a class, lacks `step` or `map`, or takes other arguments.
    """
    if not isinstance(found, type):
        raise InputError(where, f"{name}, which is no class", "a class with step(scan) and map()")
    for member in ("step", "map"):
        if not callable(getattr(found, member, None)):
            raise InputError(where, f"{name} without {member}()", "a class with step(scan) and map()")
    if inspect.isabstract(found):
        raise InputError(where, f"{name}, of which no object can be made", "a class without abstract methods")
    more = {"waveform": None} if getattr(found, "takes", "paths") == "signal" else {}
    try:
        inspect.signature(found).bind(None, prior_map=None, agent=None, seed=0, **more)
    except TypeError as error:
        allowed = CONSTRUCTOR.replace("seed=0", "seed=0, waveform=None") if more else CONSTRUCTOR
        raise InputError(where, f"{name} with a constructor that differs ({error})", allowed) from None
    except ValueError:  # written in C: it can't be asked
        pass
    return cast(type[Slam], found)


def built(
    method: type[Slam],
    scene: Scene,
    prior_map: Map | None = None,
    agent: str | None = None,
    seed: int = 0,
    waveform: Waveform | None = None,
) -> Slam:
    """Make a method's object, and see that it says whom it follows.

    Raises
    ------
    InputError
        `agent` isn't the name of the agent that was asked for; and whatever the constructor raises.
    """
    more: dict[str, Any] = {} if waveform is None else {"waveform": waveform}
    slam = method(scene, prior_map=prior_map, agent=agent, seed=seed, **more)
    wanted = agent if agent is not None else scene.agents[0].name
    found = getattr(slam, "agent", None)
    if found != wanted:
        raise InputError(f"{method.__name__}.agent", repr(found), f"{wanted!r}, the name of the agent")
    return slam


def stepped(slam: Slam, scan: Observation) -> Estimate:
    """Let a method take one step, and see that what it returns is an estimate.

    Raises
    ------
    InputError
        It isn't, is of another step, or holds arrays of other shapes or a pose that isn't finite.
    """
    estimate: object = slam.step(cast(Any, scan))  # of the kind that it takes
    where, allowed = f"{type(slam).__name__}.step", "an Estimate, e.g. by Estimate.of_pose"
    if not isinstance(estimate, Estimate):
        raise InputError(where, f"a result of type {type(estimate).__name__}", allowed)
    shapes = {"position_m": (2,), "velocity_mps": (2,), "heading_rad": (), "covariance": (5, 5)}
    for name, shape in (shapes | {"detected": (len(estimate.surfaces),)}).items():
        array = np.asarray(getattr(estimate, name))
        if array.shape != shape or array.dtype.kind not in "fiub":
            found = f"shape {array.shape} of {array.dtype}"
            raise InputError(f"{where}: {name}", found, f"numbers of shape {shape}")
        if name in POSE and not np.isfinite(array).all():
            raise InputError(f"{where}: {name}", f"NaN or infinity at step {scan.step}", "finite numbers")
    if (estimate.step, estimate.time_s) != (scan.step, scan.time_s):
        found = f"step {estimate.step} at {estimate.time_s} s"
        raise InputError(where, found, f"step {scan.step} at {scan.time_s} s, as in the scan")
    return estimate


def mapped(slam: Slam) -> Map:
    """A method's map.

    Raises
    ------
    InputError
        What it returns isn't one.
    """
    found: object = slam.map()
    if not isinstance(found, Map):
        name = type(slam).__name__
        raise InputError(
            f"{name}.map", f"a result of type {type(found).__name__}", "a Map: Map.of_scene(scene)"
        )
    return found
