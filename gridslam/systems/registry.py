"""Where methods are entered: ours by name; others by class, ``package.module:Class`` or entry point.

Nothing else lists methods. A class is imported when it is asked for, so that this list is quick to read.
"""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Iterable, Sized
from dataclasses import dataclass
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import TYPE_CHECKING, Literal, cast

from gridslam.errors import InputError

if TYPE_CHECKING:
    from gridslam.systems.slam import Slam
    from gridslam.world.observation import Kind

Antennas = Literal["single antennas", "arrays", "any"]
GROUP = "gridslam.methods"
"""Of the entry points by which other packages enter methods of theirs."""
OWN = "package.module:Class"


@dataclass(frozen=True)
class Method:
    """An entry: what has to be known before a class is imported. The rest is said by the class.

    Attributes
    ----------
    name : str
        As ``--method`` takes it.
    path : str
        Where its class is, ``package.module:Class``.
    about : str
        What it is, in one line.
    page : str
        Where ``docs/`` has its model.
    measures : str
        What it takes of what a radio measures.
    takes : "paths" or "signal"
        The kind of observation: path measurements, or sampled signals. The class has it, too, see `taken_by`:
        what isn't entered here can be asked nowhere else. A test holds that they agree.
    several : bool
        Whether it takes several agents at once.
    on_angles : bool
        Whether it lives on angles: distances alone tell it too little.
    draws_particles : bool
        Whether ``filter.particles`` means anything to it.
    maps : bool
        Whether it maps anything at all.
    learns : bool
        Whether the features of its map are learned: those of others are paths that no surface explains.
    antennas : "single antennas", "arrays" or "any"
        What received the signals that it takes.
    has_health : bool
        Whether it tells if it trusts itself.
    clocked : str
        The same method of clocks that aren't known, which stands for it there.
    """

    name: str
    path: str
    about: str
    page: str
    measures: str = "paths: distances, with angles and amplitudes where measured"
    takes: Kind = "paths"
    several: bool = False
    on_angles: bool = False
    draws_particles: bool = True
    maps: bool = True
    learns: bool = False
    antennas: Antennas = "any"
    has_health: bool = True
    clocked: str = ""


_ENTERED = (
    Method(
        "grid",
        "gridslam.systems.grid:GridSlam",
        "grid SLAM: surfaces, their reflection coefficients and an occupancy grid",
        "docs/model/grid.md#5-the-occupancy-grid",
        on_angles=True,
        clocked="network_grid",
    ),
    Method(
        "adaptive",
        "gridslam.systems.adaptive:AdaptiveSlam",
        "adaptive SLAM: surfaces alone, each ray with an amplitude of its own",
        "docs/model/ray-amplitudes.md#7-adaptive-slam-amplitudes-of-rays",
        on_angles=True,
        clocked="network",
    ),
    Method(
        "va",
        "gridslam.systems.virtual_anchor:VirtualAnchorSlam",
        "virtual-anchor SLAM: each surface serves one anchor",
        "docs/model/virtual-anchors.md#8-virtual-anchors",
    ),
    Method(
        "refa",
        "gridslam.systems.published.refa:PublishedVirtualAnchorSlam",
        "virtual-anchor SLAM by particles, as published (REFA): a reference",
        "docs/model/virtual-anchors.md#as-published",
        on_angles=True,
        has_health=False,
    ),
    Method(
        "direct",
        "gridslam.systems.direct:DirectSlam",
        "direct SLAM: agent and virtual anchors straight from sampled signals",
        "docs/model/direct.md#12-direct-slam",
        "samples over frequency, one antenna at either end; of arrays it is direct_grid",
        takes="signal",
        antennas="single antennas",
        draws_particles=False,
    ),
    Method(
        "direct_grid",
        "gridslam.systems.direct_grid:DirectGridSlam",
        "direct grid SLAM: surfaces, coefficients and an occupancy grid straight from samples of arrays",
        "docs/model/direct-grid.md#12-direct-slam-direct-grid-slam",
        "samples over frequency, an array at the agent, one antenna or an array at the anchors",
        takes="signal",
        antennas="arrays",
        draws_particles=False,
    ),
    Method(
        "direct-paper",
        "gridslam.systems.published.direct_paper:PublishedDirectSlam",
        "direct SLAM by particles, as published: a reference",
        "docs/model/direct-published.md#particles-and-messages",
        "samples over frequency, one antenna at either end",
        takes="signal",
        antennas="single antennas",
        has_health=False,
    ),
    Method(
        "network",
        "gridslam.systems.network:NetworkSlam",
        "network SLAM: several agents at once, unknown clocks, measurements that don't say whose they are",
        "docs/model/network.md#13-network-slam",
        several=True,
    ),
    Method(
        "network_grid",
        "gridslam.systems.network_grid:NetworkGridSlam",
        "network grid SLAM: the same with one occupancy grid for all",
        "docs/model/network.md#one-grid-for-all",
        several=True,
    ),
    Method(
        "network-paper",
        "gridslam.systems.published.network_paper:PublishedNetworkSlam",
        "network SLAM by particles, as published: a reference",
        "docs/model/network-published.md#as-published",
        several=True,
        on_angles=True,
        has_health=False,
    ),
    Method(
        "hybrid",
        "gridslam.systems.hybrid:HybridSlam",
        "hybrid SLAM: the line of sight by physics, learned features for all else",
        "docs/model/hybrid.md#15-hybrid-slam",
        measures="sampled signals: one antenna at the anchor; where the agent has several, its heading",
        learns=True,
        takes="signal",
    ),
    Method(
        "los",
        "gridslam.systems.hybrid:SightSlam",
        "hybrid SLAM's reference: the line of sight alone, no map",
        "docs/model/hybrid-maps.md#without-features",
        measures="sampled signals, as hybrid",
        takes="signal",
        maps=False,
    ),
    Method(
        "hybrid-known",
        "gridslam.systems.published.hybrid_known:KnownHybridSlam",
        "hybrid SLAM's other reference: told the true walls and scatterers, learns nothing",
        "docs/model/hybrid.md#15-hybrid-slam",
        measures="sampled signals, as hybrid",
        learns=True,
        takes="signal",
    ),
    Method(
        "hybrid-paper",
        "gridslam.systems.published.hybrid_paper:PublishedHybridSlam",
        "hybrid SLAM's learning as published: networks from random places, a reference",
        "docs/model/hybrid-maps.md#as-published",
        measures="sampled signals, as hybrid",
        learns=True,
        takes="signal",
    ),
)
METHODS = {entry.name: entry for entry in _ENTERED}
"""Ours, by name."""
DEFAULT = "grid"


def method_help(more: str = "") -> str:
    """What ``--method`` takes, for the command line's help."""
    return f"{', '.join(METHODS)}, or a class of your own, {OWN}{more}"


def taken_by(method: type) -> Kind:
    """What a method's class takes: its attribute `takes`, or path measurements.

    Raises
    ------
    InputError
        The attribute is something else.
    """
    found = getattr(method, "takes", "paths")
    if found not in ("paths", "signal"):
        raise InputError(f"{method.__name__}.takes", repr(found), "'paths' or 'signal'")
    return cast("Kind", found)


def uses_maps(method: type) -> bool:
    """Whether a method's class goes on from the map that an earlier agent left: its attribute, or yes."""
    return bool(getattr(method, "uses_maps", True))


def kind_of(name: str) -> Kind:
    """What the method of this name takes, if it is ours; of others, path measurements are supposed."""
    return METHODS[name].takes if name in METHODS else "paths"


def maps_features(name: str, features: Sized | None) -> int | None:
    """How many features are in the map of the method of this name; None if it learns none."""
    return None if features is None or (name in METHODS and not METHODS[name].learns) else len(features)


def particles_of(name: str, particles: int) -> int | None:
    """How many particles the method of this name draws where a scene asks for some; None if it has none."""
    return None if name in METHODS and not METHODS[name].draws_particles else particles


def method_name(method: str | type) -> str:
    """How a method is named in tables and files: as given; a class by its entry or its place."""
    if isinstance(method, str):
        return method
    place = f"{method.__module__}:{method.__qualname__}"
    return next((entry.name for entry in METHODS.values() if entry.path == place), place)


def method_class(method: str | type, where: str = "method") -> type[Slam]:
    """The class of a method.

    Parameters
    ----------
    method : str or type
        An entry's name, ``package.module:Class`` (looked for in the working folder, too), the name of an
        entry point, or the class itself.
    where : str
        What errors call it.

    Raises
    ------
    InputError
        Nothing has this name, two have it, its module can't be imported or lacks the class, or the class
        can't be a method, see `gridslam.systems.slam.Slam`.
    """
    from gridslam.systems.slam import require_slam

    if not isinstance(method, str):
        return require_slam(method, where, getattr(method, "__name__", repr(method)))
    if ":" in method:
        return require_slam(_imported(method, where), where, method)
    entered = [entry for entry in _entry_points() if entry.name == method]
    if entered:
        places, point = sorted({entry.value for entry in entered}), f"entry point {method!r} of {GROUP}"
        if method in METHODS:
            raise InputError(point, places[0], f"another name than {', '.join(METHODS)}")
        if len(places) > 1:
            raise InputError(point, " and ".join(places), "one of this name")
        return require_slam(_imported(places[0], point), where, places[0])
    if method not in METHODS:
        theirs = sorted({entry.name for entry in _entry_points()} - set(METHODS))
        from gridslam.world.validation import nearest

        known = (*METHODS, *theirs, OWN)
        close, every = nearest(method, known), ", ".join(known)
        raise InputError(where, repr(method), every if close == every else f"{close}; all: {every}")
    return cast("type[Slam]", _imported(METHODS[method].path, where))  # ours are tested, not asked


def portable_name(method: str | type, where: str = "method") -> str:
    """The name by which another process finds a method, once it is sure that this one does.

    Raises
    ------
    InputError
        As `method_class`; or a class that can't be imported, such as one of a script or a function.
    """
    found, name = method_class(method, where), method_name(method)
    if isinstance(method, type) and (found.__module__ == "__main__" or "<" in name):
        raise InputError(where, name, f"a class in a module that worker processes can import, {OWN}")
    return name


def _imported(path: str, where: str) -> object:
    """What ``package.module:Class`` stands for."""
    module, _, name = path.partition(":")
    if not all(part.isidentifier() for part in (*module.split("."), *name.split("."))):
        raise InputError(where, repr(path), OWN)
    here = os.getcwd()
    if here not in sys.path:  # last: a file of the working folder hides no installed package
        sys.path.append(here)
    try:
        found: object = importlib.import_module(module)
    except ModuleNotFoundError as error:
        missing = error.name or module
        if module == missing or module.startswith(f"{missing}."):
            raise InputError(where, f"no module {missing!r}", f"{OWN}, installed or in this folder") from None
        raise InputError(where, f"{module}, which needs {missing!r}", "a module that imports") from None
    except Exception as error:
        why = f"{module}, which can't be imported ({type(error).__name__}: {error})"
        raise InputError(where, why, "a module that imports") from None
    for part in name.split("."):
        if not hasattr(found, part):
            own = [key for key, it in vars(found).items() if getattr(it, "__module__", "") == module]
            there = ", ".join(key for key in own if hasattr(getattr(found, key), "step"))
            raise InputError(where, f"no {name} in {module}", f"{OWN}, here of {there}" if there else OWN)
        found = getattr(found, part)
    return found


def _entry_points() -> Iterable[EntryPoint]:
    """Methods of other packages: read anew where a folder of packages has changed."""
    return _entered(tuple((place, os.stat(place).st_mtime_ns) for place in sys.path if os.path.exists(place)))


@cache
def _entered(_: tuple[tuple[str, int], ...]) -> tuple[EntryPoint, ...]:
    """Methods of other packages, by the places where packages are, and when these changed."""
    return tuple(entry_points(group=GROUP))
