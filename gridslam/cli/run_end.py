"""Command line: how a run ends. Its folder, its table, and what is said of it."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from rich.console import Console
from rich.table import Table

from gridslam.cli.output import busy, ended, print_whole
from gridslam.errors import InputError
from gridslam.wording import counted

if TYPE_CHECKING:
    from gridslam.measurements.observations import Observations
    from gridslam.runs.reservation import Place
    from gridslam.runs.run import Run
    from gridslam.runs.run_files import RunFiles
    from gridslam.runs.stopping import Termination
    from gridslam.runs.unfinished import Unfinished
    from gridslam.world.scene import Scene

out, err = Console(), Console(stderr=True)
Scored = TypeVar("Scored")
SUSPECT = ": suspect: "


@dataclass(frozen=True)
class Lacks:
    """What a run lacks that was stopped once its steps were done: `what`, and `at` what it was stopped."""

    at: str
    what: str


@dataclass(frozen=True)
class Done:
    """What a run came to.

    Attributes
    ----------
    runs, observations, scores : list, one item for each agent
    settings : dict
        More entries of ``run.json``.
    progress : str
        How far it has got, if it was stopped before its last step; else nothing.
    more : mapping of str to callable
        Writers of more files, by name.
    lines : list of str
        More to say of it.
    notes : list of str
        The same, kept in ``run.json``.
    before : list of str
        Notes that were told before the run, kept in ``run.json``.
    lacks : Lacks or None
        What it was too late for when it was stopped after its last step.
    """

    runs: list[Run]
    observations: list[Observations]
    scores: list[dict[str, Any]]
    settings: dict[str, Any]
    progress: str
    more: Mapping[str, Callable[[Path], None]] = field(default_factory=dict)
    lines: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    before: list[str] = field(default_factory=list)
    lacks: Lacks | None = None

    @property
    def weighty(self) -> list[str]:
        """Who was lost, and what is suspected of the measurements: what else is said follows from these."""
        from gridslam.runs.notes import lost_note, unsaid_note

        lost = [
            lost_note(run.agent, run.trajectory, observed.truth, run.estimates)
            for run, observed, score in zip(self.runs, self.observations, self.scores, strict=True)
            if score.get("diverged")
        ]
        unsaid = [
            unsaid_note(run.agent, score, run.method)
            for run, score in zip(self.runs, self.scores, strict=True)
        ]
        return [*filter(None, (*lost, *unsaid)), *(note for note in self.notes if SUSPECT in note)]

    @property
    def other(self) -> list[str]:
        """All other notes."""
        return [note for note in self.notes if SUSPECT not in note]

    @property
    def kept(self) -> list[str]:
        """The notes of ``run.json``, the weighty first."""
        cut = [f"cut short after {self.progress}"] if self.progress else []
        cut += [f"stopped in {self.lacks.at}: {self.lacks.what} left out"] if self.lacks else []
        return [*cut, *self.weighty, *self.before, *self.other]


def judged(
    score: Callable[[], Scored], bare: Callable[[], Scored], notes: Sequence[Callable[[], list[str]]]
) -> tuple[Scored, list[str], Lacks | None]:
    """Scores of a run whose steps are done, and what is said of it; Ctrl-C ends that and costs nothing else.

    Parameters
    ----------
    score, bare : callable
        Give its scores, and those that need no truth.
    notes : sequence of callable
        Each gives some notes; those that were made before an interrupt stay.
    """
    from gridslam.runs.stopping import held_back

    scores, said = None, list[str]()
    lacks: Lacks | None = Lacks("scoring", "scores by the truth and notes")
    try:
        with busy("scoring"):
            scores = score()
        lacks = Lacks("looking at what was heard", "some notes")
        for note in notes:
            said += note()
        lacks = None
    except KeyboardInterrupt:
        pass
    if scores is None:
        with held_back():
            scores = bare()
    return scores, said, lacks


def go_on_later(folder: Path, earlier: Unfinished, termination: Termination) -> None:
    """End a run that was stopped and can be gone on with."""
    _stop(f"after {earlier.where()}; to go on: gridslam run --resume {folder}", termination)


def finish(
    folder: Path, place: Place, world: Scene, done: Done, stopped: bool, termination: Termination,
    fault: Exception | None = None,
) -> None:  # fmt: skip
    """Write the folder, say what is in it, and end with the exit code or fault of what stopped the run."""
    drawn = _written(folder, place, world, done)
    if fault is not None:
        line = f"broke off after {done.progress}: {folder} holds what was done"
        err.print(line, highlight=False, markup=False, soft_wrap=True)
        raise fault
    if drawn and not stopped and done.lacks is None:
        return
    figures = "" if drawn else f"figures (gridslam plot {folder})"
    missing = ", ".join(filter(None, (done.lacks.what if done.lacks else "", figures)))
    if done.progress:
        but = f", but for {missing}" if missing else ""
        _stop(f"after {done.progress}: {folder} holds what was done{but}", termination)
    at = f"in {done.lacks.at}, " if done.lacks else "" if drawn else "in drawing, "
    _stop(f"{at}after the last step: {folder} holds all{f' but {missing}' if missing else ''}", termination)


def _stop(line: str, termination: Termination) -> None:
    err.print(f"{ended(termination)} {line}", highlight=False, markup=False, soft_wrap=True)
    sys.exit(143 if termination.asked else 130)


def _written(folder: Path, place: Place, world: Scene, done: Done) -> bool:
    """Write the folder and say what is in it; False if Ctrl-C ended the writing or drawing."""
    from gridslam.runs.stopping import held_back

    with held_back() as asked:  # loading what draws takes a second, in which the run would be lost
        from gridslam.runs.notes import health_notes
        from gridslam.runs.run_files import write_run
        from gridslam.viewers.plots import draw_all

        kept = done.kept
    whole = not asked.is_set()

    def draw(part: Path) -> None:
        nonlocal whole
        try:
            with busy("drawing figures"):
                draw_all(part, _read_back(part, world, done))
        except KeyboardInterrupt:
            whole = False

    fault: InputError | None = None
    try:
        write_run(
            folder, world, done.runs, done.observations, done.scores,
            {**done.settings, "notes": kept}, place.overwrite, draw if whole else None, place, done.more,
        )  # fmt: skip
    except KeyboardInterrupt:
        whole = False
    except InputError as error:  # the table is worth seeing all the same
        fault = error
    print_whole(_table(done.runs, done.scores))
    unwell = [
        note
        for run, score in zip(done.runs, done.scores, strict=True)
        for note in health_notes(run.agent, score)
    ]
    for note in (*done.weighty, *unwell):
        _say(f"note: {note}")
    for line in done.lines:
        _say(line)
    for note in done.other:
        _say(f"note: {note}")
    if fault is not None:
        raise fault
    _say(f"wrote {folder}, computed on the {done.runs[-1].device}")
    return whole


def _read_back(part: Path, world: Scene, done: Done) -> RunFiles:
    """What figures are drawn from: the files or, where some couldn't be written, what they would hold."""
    from gridslam.runs.run_files import AgentFiles, RunFiles, read_run

    try:
        return read_run(part, {run.agent: run.map for run in done.runs})
    except InputError:
        agents = {
            run.agent: AgentFiles(observed, run.trajectory, observed.truth, run.estimates, run.map)
            for run, observed in zip(done.runs, done.observations, strict=True)
        }
        return RunFiles(world, {"method": done.runs[-1].method}, agents)


def _say(line: str) -> None:
    out.print(line, highlight=False, markup=False, soft_wrap=True)


def _table(runs: list[Run], scores: list[dict[str, Any]]) -> Table:
    """One line per agent; units in the titles."""
    table = Table(box=None, pad_edge=False, padding=(0, 1, 0, 0))
    titles = (
        "agent",
        "steps",
        "position\nRMSE cm",
        "bound\ncm",
        "heading\nRMSE deg",
        "bound\ndeg",
    )
    for title in (
        *titles,
        "NEES\nmedian",
        "surfaces\nfound true false",
        "map\nprec.",
        "map\nrecall",
        "s/step",
    ):
        table.add_column(title, justify="left" if title == "agent" else "right", no_wrap=True)

    def number(value: float | None, form: str, scale: float = 1, own: float | None = None) -> str:
        if value is None and own is not None:  # without a truth, what the filter says itself
            return f"+-{number(own, form, scale)}"
        if value is None:
            return "-"
        # of a lost agent: more digits would push the table beyond a terminal
        return format(scale * value, ".0f" if abs(scale * value) >= 100 and form == ".2f" else form)

    for done, score in zip(runs, scores, strict=True):
        found, matched, true = (score[f"surfaces_{key}"] for key in ("detected", "matched", "true"))
        of = "" if true is None else f" {matched}/{true} {score['surfaces_false']}"
        if found is None:
            found = "-" if score["features"] is None else counted(score["features"], "feature")
        table.add_row(
            done.agent,
            str(score["steps"]),
            number(score["position_rmse_m"], ".2f", 100, score["position_std_m"]),
            number(score["position_bound_m"], ".2f", 100),
            number(score["heading_rmse_deg"], ".2f", 1, score["heading_std_deg"]),
            number(score["heading_bound_deg"], ".2f"),
            number(score["position_median_nees"], ".2f"),
            f"{found}{of}",
            number(score["map"]["occupied_precision"], ".1%"),
            number(score["map"]["occupied_recall"], ".1%"),
            number(score["seconds_per_step"], ".3f"),
        )
    return table
