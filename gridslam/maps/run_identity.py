"""Which run a map's evidence comes from: a name that follows from what was heard, and tells repeats apart."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from gridslam.errors import InputError

if TYPE_CHECKING:
    from gridslam.maps.map_cells import MapCells
    from gridslam.world.observation import Observation

DIGITS = 8


@dataclass(frozen=True)
class Identity:
    """Identity of a run, which grows while it goes on.

    Evidence is that of measurements: whatever filter, seed or device took them in, they must not count
    twice. So the identity is a chain of checksums of all that was heard, noted after 1, 2, 4, 8, ... steps at
    which anything was. The same measurements have the same identity, and that of a run's first steps begins
    that of the whole run.

    Attributes
    ----------
    chain : str
        Checksum of all that was heard.
    scans : int
        Steps at which anything was.
    text : str
        What was noted.
    """

    chain: str
    scans: int = 0
    text: str = ""

    @classmethod
    def of(cls, places: np.ndarray) -> Identity:
        """Before anything is heard of anchors at `places` (J, 2), m."""
        return cls(hashlib.sha256(np.ascontiguousarray(places, "<f8").tobytes()).hexdigest())

    def after(self, scan: Observation) -> Identity:
        """The identity once what was heard at a step was taken in."""
        if not len(scan):
            return self
        link = hashlib.sha256(self.chain.encode())
        link.update(np.array([scan.step, scan.time_s], "<f8").tobytes())
        link.update(b"".join(b"-" if column is None else _bytes(column) for column in scan.content()))
        chain, scans = link.hexdigest(), self.scans + 1
        return Identity(chain, scans, self.text + (chain[:DIGITS] if scans & (scans - 1) == 0 else ""))

    def __str__(self) -> str:
        """All of it as text, for checkpoints."""
        return f"{self.chain} {self.scans} {self.text}"

    @classmethod
    def parse(cls, text: str) -> Identity:
        """From the text of a checkpoint."""
        chain, scans, *rest = text.split()
        return cls(chain, int(scans), "".join(rest))


def _bytes(column: np.ndarray) -> bytes:
    """Of a column's numbers: NaN has many, and which of them it is depends on how a table came to be."""
    numbers = np.array(column, "<f8")
    numbers[np.isnan(numbers)] = np.nan
    return numbers.tobytes()


def same_run(one: str, other: str) -> bool:
    """Whether two identities begin with the same measurements; unknown ones ("") never do.

    So does a run with its own beginning, and with another that went on from the same checkpoint.
    """
    return bool(one and other) and one[:DIGITS] == other[:DIGITS]


def refuse_heard(provenance: Mapping[str, object], heard: Identity, where: str = "map") -> None:
    """Refuse measurements that a map was made of: with it, their evidence would count twice.

    Parameters
    ----------
    provenance : mapping
        Of the map that a run begins with.
    heard : Identity
        Of the run, once anything was heard.
    where : str
        Names the map in the error.

    Raises
    ------
    InputError
        Another run of the map is made of the same measurements.
    """
    for run, *whose in _records(provenance):
        if same_run(run, heard.text):
            found = f"{_in_words(run, *whose)} in it, made of these very measurements: they would count twice"
            allowed = "a map made without them, or what another agent heard (simulated: another seed)"
            raise InputError(where, found, allowed)


def first_identity(places: np.ndarray, heard: Iterable[Observation]) -> Identity:
    """Identity of a run after the first step at which anything was heard of anchors at `places` (J, 2)."""
    start = Identity.of(places)
    return next((start.after(scan) for scan in heard if len(scan)), start)


def refuse_repeated_runs(grid: MapCells, where: str) -> None:
    """Refuse a map that holds the evidence of a run twice, as earlier versions made them.

    Raises
    ------
    InputError
        Two of its runs are of the same measurements.
    """
    repeated = repeated_run(grid)
    if repeated:
        raise InputError(where, f"the evidence of {repeated} twice", "a map that holds each run once")


def repeated_run(grid: MapCells) -> str | None:
    """Which run a map holds twice, in words; mostly none."""
    rows = _records(grid.provenance)
    for number, (run, *whose) in enumerate(rows):
        if any(same_run(run, earlier[0]) for earlier in rows[:number]):
            return _in_words(run, *whose)
    return None


def alike_runs(grid: MapCells) -> list[str]:
    """Runs of a map that may have heard one pass twice: its samples, and the paths extracted from them.

    Their checksums differ, as their numbers do; agent, seed and number of steps are the same. So they are in
    simulation, whose samples and paths are drawn apart: hence this is told, and not refused.
    """
    rows, kinds = _records(grid.provenance), _items(grid.provenance, "kinds")
    if len(kinds) != len(rows):  # a map of an earlier version is among those it is made of
        return []
    notes = []
    for number, (run, *whose) in enumerate(rows):
        for earlier, (other, *who) in enumerate(rows[:number]):
            if who == whose and {kinds[number], kinds[earlier]} == {"paths", "signal"}:
                pair = f"{other[:DIGITS]} and {run[:DIGITS]}"
                notes.append(
                    f"map: {whose[0]}'s runs {pair} heard samples and paths, at {whose[2]} steps each: if "
                    "the paths were extracted from those samples, they count twice"
                )
    return notes


def makers_of(prior: MapCells | None) -> dict[str, list[Any]]:
    """Who made the map that a filter starts from, as parallel lists."""
    earlier = {} if prior is None else prior.provenance
    names = earlier.get("told")
    return parallel(earlier) | ({"told": list(names)} if isinstance(names, list) else {})


def parallel(provenance: Mapping[str, object]) -> dict[str, list[Any]]:
    """The lists of a provenance that run parallel, blank where an earlier version didn't say.

    Maps of one fused with another may lack runs or kinds of some: of kinds nobody knows whose they are.
    """
    lists = {key: provenance.get(key) for key in ("agents", "seeds", "steps", "runs", "kinds")}
    known = {key: list(value) if isinstance(value, list) else [] for key, value in lists.items()}
    count = len(known["agents"])
    known["runs"] = [""] * (count - len(known["runs"])) + known["runs"]
    known["kinds"] = known["kinds"] if len(known["kinds"]) == count else [""] * count
    return known


def refuse_shared_runs(maps: Sequence[MapCells], names: Sequence[str]) -> None:
    """Refuse maps that hold the evidence of the same run, which would count twice.

    Maps of earlier versions don't say which runs they are made of: of those, equal ones are refused, and one
    that begins another's list of agents, seeds and steps.

    Parameters
    ----------
    maps : sequence of Map
    names : sequence of str
        What errors call them.

    Raises
    ------
    InputError
        Two maps share a run, or one holds a run twice.
    """
    for grid, name in zip(maps, names, strict=True):
        refuse_repeated_runs(grid, name)
    for second in range(len(maps)):
        for first in range(second):
            shared = _shared(maps[first], maps[second])
            if shared:
                found = f"{names[first]} and {names[second]}, both with the evidence of {shared}"
                raise InputError("fuse", found, "independent maps, none made of a run that another holds")


def _shared(one: MapCells, other: MapCells) -> str | None:
    """What two maps share, in words."""
    records = [_records(grid.provenance) for grid in (one, other)]
    for run, *whose in records[0]:
        if any(same_run(run, there[0]) for there in records[1]):
            return _in_words(run, *whose)
    if all(run for record in records for run, *_ in record) and all(records):
        return None
    short, whole = sorted(([row[1:] for row in record] for record in records), key=len)
    if short and len(short) < len(whole) and whole[: len(short)] == short:
        return f"{', '.join(str(row[0]) for row in short)}, of which one was built on the other"
    here = np.array_equal(one.origin_m, other.origin_m)
    same = here and one.evidence.any() and np.array_equal(one.evidence, other.evidence)
    return "the same measurements" if same else None


def _in_words(run: str, agent: object, seed: object, steps: object) -> str:
    return f"{agent}'s run {run[:DIGITS]} (seed {seed}, {steps} steps)"


def _records(provenance: Mapping[str, object]) -> list[tuple[str, object, object, object]]:
    """Identity, agent, seed and steps of the runs that a map is made of."""
    agents, seeds, steps, runs = (_items(provenance, key) for key in ("agents", "seeds", "steps", "runs"))
    count = max(min(len(agents), len(seeds), len(steps)), len(runs))
    agents, seeds, steps, runs = ((column + [""] * count)[:count] for column in (agents, seeds, steps, runs))
    return [(str(run), *rest) for run, *rest in zip(runs, agents, seeds, steps, strict=True)]


def _items(provenance: Mapping[str, object], key: str) -> list:
    value = provenance.get(key, [])
    return value if isinstance(value, list) else [value]
