"""An agent's way: time, position, velocity and heading, and its TUM file."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gridslam.arrays import Array
from gridslam.errors import InputError
from gridslam.io.files import write_bytes
from gridslam.io.foreign import refuse_foreign_text
from gridslam.world.geometry import wrap
from gridslam.world.given import SECONDS, numbers, require_radians

HOLE_INTERVALS, HOLE_S = 10.0, 1.0
"""How much longer than most a pause between poses of a track is that is a hole in it, and at least, s."""
STANDS_M, MANY, MOST_HOLES = 0.1, 3, 0.3
"""How near the poses at both ends of a pause are if the agent stood; pauses, and share of a track's time,
beyond which they are no holes, but legs between poses at corners."""
HOLE, ENDS_S = "hole from, to:", 1e-6
TUM_COLUMNS = "timestamp tx ty tz qx qy qz qw"


@dataclass(frozen=True, eq=False)
class Trajectory:
    """States of an agent over time, read-only.

    Attributes
    ----------
    time_s : (N,) float64
        Strictly rising.
    position_m : (N, 2) float64
    velocity_mps : (N, 2) float64
    heading_rad : (N,) float64
        Counter-clockwise from x, in (-pi, pi].
    height_m : (N,) float64 or None
        None in a planar world.
    holes_s : (H, 2) float64 or None
        Spans in which nothing is known of the way, as where a camera lost it: poses there are filled in.

    Raises
    ------
    InputError
        Shapes that don't match, NaN or infinity, or times that don't rise.
    """

    time_s: Array
    position_m: Array
    velocity_mps: Array
    heading_rad: Array
    height_m: Array | None = None
    holes_s: Array | None = None

    def __post_init__(self) -> None:
        count = np.size(self.time_s)
        shapes = {
            "time_s": (count,),
            "position_m": (count, 2),
            "velocity_mps": (count, 2),
            "heading_rad": (count,),
        }
        if self.height_m is not None:
            shapes["height_m"] = (count,)
        for name, shape in shapes.items():
            allowed = SECONDS if name == "time_s" else "numbers"
            values = numbers(getattr(self, name), f"trajectory: {name}", allowed)
            if values.shape != shape:
                raise InputError(f"trajectory: {name}", f"shape {values.shape}", f"shape {shape}")
            if not np.isfinite(values).all():
                raise InputError(f"trajectory: {name}", "NaN or infinity", "finite numbers")
            if name == "heading_rad":
                require_radians(values, "trajectory")
                values = wrap(values)
            values.setflags(write=False)
            object.__setattr__(self, name, values)
        if self.holes_s is not None:
            spans = numbers(self.holes_s, "trajectory: holes_s")
            if spans.ndim != 2 or spans.shape[1] != 2:
                raise InputError("trajectory: holes_s", f"shape {spans.shape}", "shape (H, 2)")
            spans.setflags(write=False)
            object.__setattr__(self, "holes_s", spans)
        if (np.diff(self.time_s) <= 0).any():
            raise InputError("trajectory: time_s", "times that don't rise", "strictly rising times")

    @classmethod
    def of_poses(
        cls,
        time_s: ArrayLike,
        position_m: ArrayLike,
        heading_rad: ArrayLike | None = None,
        height_m: ArrayLike | None = None,
    ) -> Trajectory:
        """A track whose velocities are finite differences of its positions.

        Parameters
        ----------
        time_s : (N,)
            Strictly rising.
        position_m : (N, 2)
        heading_rad : (N,), optional
            Default: the direction of motion, and while it stands still that before (at first the first one).
        height_m : (N,), optional

        Raises
        ------
        InputError
            As of a trajectory.
        """
        time = numbers(time_s, "trajectory: time_s", SECONDS)
        position = numbers(position_m, "trajectory: position_m")
        if time.ndim != 1 or position.shape != (len(time), 2):
            raise InputError("trajectory: position_m", f"shape {position.shape}", f"({time.size}, 2)")
        if not np.isfinite(time).all() or (np.diff(time) <= 0).any():
            raise InputError("trajectory: time_s", "times that don't rise", "strictly rising times")
        velocity = np.gradient(position, time, axis=0) if len(time) > 1 else np.zeros_like(position)
        turn = (
            _of_motion(velocity) if heading_rad is None else numbers(heading_rad, "trajectory: heading_rad")
        )
        high = None if height_m is None else numbers(height_m, "trajectory: height_m")
        return cls(time, position, velocity, turn, high)

    def __repr__(self) -> str:
        """One line."""
        if not len(self):
            return "<Trajectory without poses>"
        way = float(np.hypot(*np.diff(self.position_m, axis=0).T).sum())
        return f"<Trajectory of {len(self)} poses, {way:.1f} m in {np.ptp(self.time_s):g} s>"

    def __len__(self) -> int:
        return len(self.time_s)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Trajectory):
            return NotImplemented
        return all(np.array_equal(getattr(self, f.name), getattr(other, f.name)) for f in fields(self))

    def at(self, time_s: Array) -> Trajectory:
        """The track at other times, between its poses on straight lines; before and after it stands still.

        Long pauses between its poses are holes of what is returned, see `holes`.

        Parameters
        ----------
        time_s : (N,) float64
            Strictly rising.
        """
        columns = [*self.position_m.T, *self.velocity_mps.T, np.unwrap(self.heading_rad)]
        x, y, vx, vy, heading = (np.interp(time_s, self.time_s, column) for column in columns)
        high = None if self.height_m is None else np.interp(time_s, self.time_s, self.height_m)
        holes = self.holes()
        return Trajectory(
            time_s, np.stack([x, y], -1), np.stack([vx, vy], -1), wrap(heading), high,
            holes if len(holes) else None,
        )  # fmt: skip

    def holes(self) -> Array:
        """Spans (H, 2) s without poses: those known as such, and pauses far longer than most intervals.

        An agent that stands, of which nothing is noted until it goes on, has none; nor has a track that is
        drawn from corner to corner.
        """
        known = np.zeros((0, 2)) if self.holes_s is None else self.holes_s
        step = np.diff(self.time_s)
        if not len(step):
            return known
        long = step > max(HOLE_INTERVALS * float(np.median(step)), HOLE_S)
        long &= np.hypot(*np.diff(self.position_m, axis=0).T) > STANDS_M
        if long.sum() > MANY and step[long].sum() > MOST_HOLES * step.sum():
            return known
        return np.concatenate([known, np.stack([self.time_s[:-1], self.time_s[1:]], -1)[long]])

    def line_m(self, until_s: float = np.inf) -> Array:
        """Positions (M, 2) m as a line is drawn, up to a time; NaN where `holes` break it."""
        holes = self.holes()
        time = np.concatenate([self.time_s, holes.mean(1)])
        place = np.concatenate([self.position_m, np.full((len(holes), 2), np.nan)])
        place[: len(self)][self.in_hole(self.time_s)] = np.nan
        order = np.argsort(time, kind="stable")
        return place[order][time[order] <= until_s]

    def in_hole(self, time_s: Array) -> NDArray[np.bool_]:
        """Whether times (N,) s lie within `holes`, (N,); at the ends of one there are poses."""
        first, last = self.holes().T
        time = np.asarray(time_s)[:, None]
        return np.asarray(((time > first + ENDS_S) & (time < last - ENDS_S)).any(1))

    def to_tum(self, path: str | os.PathLike[str], remark: str | None = None) -> None:
        """Write ``timestamp tx ty tz qx qy qz qw`` lines at full precision; ``tz`` is 0 in a plane.

        Poses in holes are there, too; a remark says of each hole from when to when it is.

        Parameters
        ----------
        path : path
        remark : str, optional
            One line behind the names of the columns, as that nothing tells headings: TUM has no room for it.

        Raises
        ------
        InputError
            The file can't be written, or another that isn't as this writes it has the name.
        """
        refuse_foreign_text(path, "a track that was written here (.tum)", _as_written)
        half = 0.5 * self.heading_rad
        high = ["0"] * len(self) if self.height_m is None else [repr(z) for z in self.height_m.tolist()]
        rows = zip(self.time_s, *self.position_m.T, high, np.sin(half), np.cos(half), strict=True)
        spans = [] if self.holes_s is None else self.holes_s.tolist()
        remarks = [*([remark] if remark else []), *(f"{HOLE} {first!r} {last!r}" for first, last in spans)]
        lines = [f"# {TUM_COLUMNS}", *(f"# {line}" for line in remarks)] + [
            f"{float(t)!r} {float(x)!r} {float(y)!r} {z} 0 0 {float(s)!r} {float(c)!r}"
            for t, x, y, z, s, c in rows
        ]
        write_bytes(path, ("\n".join(lines) + "\n").encode())

    @classmethod
    def from_tum(cls, path: str | os.PathLike[str]) -> Trajectory:
        """Read a TUM file without tilts; velocities come from finite differences, heights where one isn't 0.

        Raises
        ------
        InputError
            No such file, no poses, a line without eight finite numbers, a rotation out of the plane,
            or times that don't rise.
        """
        try:
            text = Path(path).read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            reason = getattr(error, "strerror", None) or "bytes that aren't text"
            raise InputError(str(path), reason, "a TUM trajectory file") from error
        rows, holes = [], list[list[float]]()
        for number, line in enumerate(text.splitlines(), start=1):
            if (span := re.fullmatch(rf"# {HOLE} (\S+) (\S+)", line)) is not None:
                holes.append(_numbers(span.groups()))
            words = line.split("#")[0].split()
            if words:
                rows.append(_pose(words, f"{path}: line {number}"))
                if len(rows) > 1 and rows[-1][0] <= rows[-2][0]:
                    raise InputError(
                        f"{path}: line {number}: timestamp", words[0], f"more than {rows[-2][0]!r}"
                    )
        if not rows:
            raise InputError(str(path), "no poses", f"lines of {TUM_COLUMNS}")
        table = np.array(rows)
        high = table[:, 3] if table[:, 3].any() else None
        track = cls.of_poses(table[:, 0], table[:, 1:3], 2 * np.arctan2(table[:, 6], table[:, 7]), high)
        spans = [span for span in holes if len(span) == 2]
        return replace(track, holes_s=np.array(spans)) if spans else track


def _of_motion(velocity_mps: Array) -> Array:
    """Directions (N,) of velocities (N, 2), rad; where there is none, that before, or else the first one."""
    moving = np.flatnonzero((velocity_mps != 0).any(1))
    if not len(moving):
        return np.zeros(len(velocity_mps))
    latest = moving[np.maximum(np.searchsorted(moving, np.arange(len(velocity_mps)), side="right") - 1, 0)]
    return np.asarray(np.arctan2(velocity_mps[latest, 1], velocity_mps[latest, 0]))


def _as_written(head: str) -> bool:
    """Whether a file begins as `Trajectory.to_tum` has it."""
    return head.startswith(f"# {TUM_COLUMNS}\n")


def _numbers(words: Sequence[str]) -> list[float]:
    """The words as numbers; none if one isn't."""
    try:
        return [float(word) for word in words]
    except ValueError:
        return []


def _pose(words: list[str], where: str) -> list[float]:
    """Eight numbers of one line, checked."""
    values = _numbers(words)
    if len(values) != 8 or not np.isfinite(values).all():
        raise InputError(where, " ".join(words)[:60], f"eight finite numbers: {TUM_COLUMNS}")
    if abs(values[4]) > 1e-6 or abs(values[5]) > 1e-6:
        raise InputError(f"{where}: qx qy", f"{values[4]} {values[5]}", "0 0, a rotation in the plane")
    if abs(np.hypot(values[6], values[7]) - 1) > 1e-3:
        raise InputError(f"{where}: qz qw", f"{values[6]} {values[7]}", "a unit quaternion")
    return values
