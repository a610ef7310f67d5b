"""What a run needs to go on after an interruption: checkpoints of its agents in turn, on disk.

A run is a fold of steps over its agents. So of each agent that has begun are kept what it hears, the filter's
own checkpoint (which agents that are through keep, too: their maps follow from it), and its estimates so far,
in pieces. No file that counts is written again: ``unfinished.json`` names those that do, with checksums, and
is replaced at once and last. Whatever ends a run leaves the checkpoint before or the new one.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any, Protocol

from gridslam.errors import InputError
from gridslam.io.files import cannot_write, put_in_place, settle_folder, write_bytes
from gridslam.measurements.network import NetworkMeasurements
from gridslam.measurements.observations import NAMES, Observations, kind_of, read_observations
from gridslam.runs.parts import INDEX, UNFINISHED, how_it_ended, unfinished_part
from gridslam.runs.pieces import OfOne, OfSeveral, Pieces, exact_json
from gridslam.runs.reservation import Place
from gridslam.world.scene import Scene

FORMAT, VERSION = "gridslam-unfinished", 2
ANEW = "what a run of this version wrote (or a new run with --overwrite)"


class Savable(Protocol):
    """A filter whose state can be saved."""

    def save(self, path: str | os.PathLike[str], /) -> None:
        """Write all that `resume` of the class needs."""


@dataclass
class Progress:
    """How far an agent has got.

    Attributes
    ----------
    name : str
    total : int
        Steps that it has measurements of.
    pieces : list of int
        Step after the last one of each piece of its estimates; the last of them is that of the filter.
    seconds, peak_mb : list of float, float; s, MiB
        What each step took, and all of them at most.
    """

    name: str
    total: int
    pieces: list[int] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    peak_mb: float = 0.0

    @property
    def done(self) -> int:
        """Steps that are kept."""
        return self.pieces[-1] if self.pieces else 0


class Unfinished:
    """The checkpoint of a run.

    Attributes
    ----------
    folder : Path
    settings : dict
        What the run was asked for; "checkpoint" is the number of steps between two checkpoints.
    scene : str
        Resolved scene, as TOML.
    sources : dict of str
        Checksums of the files that the run read, by path.
    agents : list of Progress
        Those that have begun, in turn.
    files : dict of str
        Checksums of the files that count, by name.
    """

    def __init__(
        self,
        folder: Path,
        settings: dict[str, Any],
        scene: str,
        sources: dict[str, str],
        agents: Sequence[Progress] = (),
        files: Mapping[str, str] | None = None,
    ) -> None:
        self.folder, self.settings, self.scene, self.sources = folder, settings, scene, sources
        self.agents, self.files = list(agents), dict(files or {})

    @classmethod
    def begin(
        cls, place: Place, settings: Mapping[str, Any], scene: Scene, sources: Sequence[Path]
    ) -> Unfinished:
        """Start to keep a new run, in the place of what an earlier one left to go on with.

        Parameters
        ----------
        settings : mapping
            As the attribute; what JSON can hold.
        sources : sequence of path
            Files that mustn't change until the run is through, beside the scene.

        Raises
        ------
        InputError
            Nothing can be written.
        """
        place.drop_checkpoint()
        new = cls(place.part / UNFINISHED, dict(settings), scene.to_toml(), {})
        try:
            new.sources = {str(path.resolve()): _checksum(path) for path in sources}
            new.folder.mkdir(exist_ok=True)
            for folder in (place.part, place.part.parent):
                settle_folder(folder)
        except OSError as error:
            raise cannot_write(new.folder, error) from error
        new._commit([], {})
        return new

    @classmethod
    def read(cls, part: Path) -> Unfinished:
        """Read which run it is and how far it has got.

        Raises
        ------
        InputError
            Not a checkpoint, one of another version, or damaged.
        """
        path = part / UNFINISHED / INDEX
        try:
            index = json.loads(path.read_bytes())
            content, seal = index["content"], index["checksum"]
            form = [index["format"], index["version"], index["gridslam"]]
        except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
            raise InputError(str(path), "damaged content", ANEW) from error
        if form != _form():
            found = f"{form[0]} {form[1]} of gridslam {form[2]}"
            raise InputError(str(path), found, "{} {} of gridslam {}".format(*_form()))
        if _text_checksum(exact_json(content)) != seal:
            raise InputError(str(path), "damaged content", ANEW)
        agents = [Progress(**agent) for agent in content.pop("agents")]
        return cls(path.parent, agents=agents, **content)

    def check(self, scene: Scene) -> None:
        """Refuse to go on if anything isn't as it was; remove what doesn't count.

        Raises
        ------
        InputError
            Another scene, a source that has changed or is gone, a file of the checkpoint that is damaged.
        """
        as_it_was = "what it was when the run began (or a new run with --overwrite)"
        if scene.to_toml() != self.scene:
            raise InputError(f"{scene.name}: scene", "one that has changed since", as_it_was)
        for path, known in self.sources.items():
            _require(Path(path), known, "other content than before", as_it_was)
        for name, known in self.files.items():
            _require(self.folder / name, known, "damaged content", ANEW)
        self._sweep()

    def measurements(self, number: int) -> Observations | None:
        """What agent `number` hears, if it has begun."""
        if number >= len(self.agents):
            return None
        return read_observations(self.folder, f"{number}-")

    def network_measurements(self) -> NetworkMeasurements | None:
        """What all agents of a run at once hear, if it has begun."""
        return NetworkMeasurements.from_h5(self.folder / f"0-{NAMES['paths']}") if self.agents else None

    def agent(
        self, number: int, name: str, observations: Observations | NetworkMeasurements
    ) -> AgentCheckpoint:
        """Keep agent `number`, from its beginning or from where it has got to; several at once are one.

        Raises
        ------
        InputError
            Nothing can be written.
        """
        if number == len(self.agents):
            kind = "paths" if isinstance(observations, NetworkMeasurements) else kind_of(observations)
            own = f"{number}-{NAMES[kind]}"
            observations.to_h5(self.folder / own)
            self._commit(
                [*self.agents, Progress(name, len(observations))], {own: _checksum(self.folder / own)}
            )
        several = OfSeveral(observations.agents) if isinstance(observations, NetworkMeasurements) else None
        return AgentCheckpoint(self, number, OfOne() if several is None else several)

    def where(self) -> str:
        """How far the run has got, in words."""
        if not self.agents:
            return "no step"
        last = self.agents[-1]
        far = "all" if last.done == last.total else f"{last.done} of"
        return f"{far} {last.total} steps of {last.name}"

    def _commit(self, agents: list[Progress], new: Mapping[str, str], old: str = "") -> None:
        """Let new files count, and an old one no longer."""
        files = {name: known for name, known in self.files.items() if name != old} | dict(new)
        content = {
            "settings": self.settings,
            "scene": self.scene,
            "sources": self.sources,
            "agents": [asdict(agent) for agent in agents],
            "files": files,
        }
        form = dict(zip(("format", "version", "gridslam"), _form(), strict=True))
        index = form | {"content": content, "checksum": _text_checksum(exact_json(content))}
        write_bytes(self.folder / INDEX, exact_json(index))
        self.agents, self.files = agents, files
        if old:
            (self.folder / old).unlink(missing_ok=True)

    def _sweep(self) -> None:
        """Remove what was written for a checkpoint that never counted."""
        for path in self.folder.iterdir():
            if path.name not in self.files and path.name != INDEX and path.is_file():
                path.unlink()


class AgentCheckpoint:
    """The part of a run's checkpoint that is one agent's, or that of several at once.

    `gridslam.map_scene` and `gridslam.map_network` keep it up to date.
    """

    def __init__(self, run: Unfinished, number: int, pieces: Pieces[Any]) -> None:
        self.run, self.number, self.pieces = run, number, pieces

    @property
    def progress(self) -> Progress:
        """How far the agent has got."""
        return self.run.agents[self.number]

    def resumed(self, system: Any) -> tuple[Any, list[Any]] | None:
        """Filter of a class `system` and estimates from which the agent goes on; None if it is to begin.

        Raises
        ------
        InputError
            A file is damaged, or of another system.
        """
        if not self.progress.done:
            return None
        estimates: list[Any] = []
        for end in self.progress.pieces:
            estimates += self.pieces.read(self.run.folder, self.number, end)
            if len(estimates) != end:
                found = f"{self.number}-steps-{end}: steps up to {len(estimates)}"
                raise InputError(str(self.run.folder), found, f"to {end}")
        return system.resume(self._filter(self.progress.done)), estimates

    def keep(
        self, slam: Savable, estimates: Sequence[Any], seconds: list[float], peak_mb: float, now: bool = False
    ) -> None:
        """Write a checkpoint after a step, if one is due or wanted now.

        Parameters
        ----------
        estimates : sequence of Estimate or NetworkEstimate
            Of all steps so far.
        seconds, peak_mb : list of float, float; s, MiB
            As those of `Progress`.

        Raises
        ------
        InputError
            It can't be written; the one before is still there.
        """
        before, done = self.progress, len(estimates)
        through = now or done == before.total or done - before.done >= int(self.run.settings["checkpoint"])
        if done == before.done or not through:
            return
        new = self.pieces.write(self.run.folder, self.number, done, estimates[before.done :])
        state = self._filter(done)
        part = state.with_name(f"{state.stem}.part{state.suffix}")
        try:
            slam.save(part)
            put_in_place(part, state)
            known = {path.name: _checksum(path) for path in (*new, state)}
        except OSError as error:
            raise cannot_write(state, error) from error
        after = replace(before, pieces=[*before.pieces, done], seconds=list(seconds), peak_mb=peak_mb)
        old = self._filter(before.done).name if before.done else ""
        self.run._commit([*self.run.agents[: self.number], after], known, old)

    def _filter(self, step: int) -> Path:
        return self.run.folder / f"{self.number}-filter-{step}.h5"


def read_unfinished(directory: str | os.PathLike[str]) -> Unfinished:
    """The unfinished run into a folder, whoever may be at work on it.

    Raises
    ------
    InputError
        There is none, or it can't be read.
    """
    part = unfinished_part(directory)
    if part is None:
        found = how_it_ended(Path(directory)) or "no unfinished run"
        raise InputError(str(directory), found, "the folder of a run with --checkpoint")
    return Unfinished.read(part)


def require_savable(method: str, system: object) -> None:
    """Refuse to keep a system that can't be.

    Raises
    ------
    InputError
        It lacks `save` or `resume`.
    """
    for name in ("save", "resume"):
        if not callable(getattr(system, name, None)):
            raise InputError("--checkpoint", f"method {method!r}, which has no {name!r}", "one that has")


def _form() -> list[Any]:
    return [FORMAT, VERSION, version("gridslam")]


def _require(path: Path, known: str, changed: str, allowed: str) -> None:
    """Refuse a file that isn't the known one."""
    try:
        same = _checksum(path) == known
    except OSError as error:
        raise InputError(str(path), error.strerror or str(error), allowed) from error
    if not same:
        raise InputError(str(path), changed, allowed)


def _checksum(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _text_checksum(text: bytes) -> str:
    return hashlib.sha256(text).hexdigest()
