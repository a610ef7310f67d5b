"""What HDF5 files hold, described once: writers take units and types from it, readers ranges and shapes.

docs/generate.py prints the same descriptions as the reference of the files. They stand beside the writers:
`gridslam.measurements.datasets`, `gridslam.maps.map_datasets`, `gridslam.runs.step_datasets`,
`gridslam.runs.network_files`. Those of JSON and CSV files are in `gridslam.runs.summary` and
`gridslam.studies.columns`.
"""

from __future__ import annotations

import os
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from gridslam.errors import InputError
from gridslam.io.files import fits, get, put, subgroup
from gridslam.io.hdf5_limits import place_of
from gridslam.quantity import REQUIRED, Quantity

AXIS = re.compile(r"(?:(\d+) )?([A-Za-z]+)(?: \+ (\d+))?")
ROUNDING = 1e-6
"""By which numbers may be beyond a limit that is allowed itself."""
NUMBERS, TEXT, WHOLE, TRUTH = "fiub", "OS", ("int32", "int64"), "bool"


@dataclass(frozen=True, kw_only=True)
class Dataset(Quantity):
    """A dataset, or an attribute, of a group of an HDF5 file.

    Its name is ``dataset``, ``@attribute`` (of the group) or ``dataset@attribute``.

    Attributes
    ----------
    shape : str
        Sizes as letters, which stand for the same in all of a file, numbers and simple terms of both:
        "S, 2", "3 F, 3 F", "N + 1", "J, 2 or 3"; empty for one value.
    kind : str
        Type of NumPy that it is written in, or "text".
    nan : str
        What NaN says, where it may be; empty if it mayn't.
    endless : bool
        Whether a number may be infinite.
    free : bool
        Whether it may be anything else in files of other programs, and is passed over then.
    """

    shape: str = ""
    kind: str = "float64"
    nan: str = ""
    endless: bool = False
    free: bool = False

    @property
    def allowed(self) -> str:
        """Which values, in words."""
        words = f"{self._words}; NaN: {self.nan}" if self.nan else self._words
        return f"{words}, not checked" if self.free else words

    @property
    def _words(self) -> str:
        if self.kind in ("text", TRUTH):
            return "text" if self.kind == "text" else "true or false"
        return "any number" if self.endless and not np.isfinite(self.least) else super().allowed

    @property
    def required(self) -> bool:
        """Whether a group can't do without."""
        return self.default == REQUIRED

    def rows(self, values: Sequence[Any]) -> NDArray[Any]:
        """One value per row, as an array of its shape, also of no rows."""
        sizes = [int(axis) for axis in self.shape.split(", ")[1:]]
        return np.array(values, self.kind).reshape(len(values), *sizes)

    def put(self, group: h5py.Group, value: Any) -> None:
        """Write it into its group; attributes of datasets after those."""
        owner, mark, name = self.name.rpartition("@")
        if mark:
            place = group[owner] if owner else group
            if self.kind == "text" and self.shape:
                place.attrs.create(name, list(value), dtype=h5py.string_dtype(), shape=(len(value),))
            else:
                place.attrs[name] = value if self.kind == "text" else np.asarray(value, self.kind)[()]
        elif self.kind == "text":
            put(group, name, np.array(value, dtype=h5py.string_dtype()), self.unit)
        else:
            put(group, name, np.asarray(value, self.kind), self.unit)

    def get(self, group: h5py.Group, sizes: dict[str, int], checked: bool = True) -> Any:
        """Read it out of its group.

        Parameters
        ----------
        group : h5py.Group
        sizes : dict of int
            What letters of shapes stand for, as far as it is known; takes those that this one tells.
        checked : bool
            Whether numbers are held to their range, not only to shape and type.

        Returns
        -------
        array of the described type, tuple of str, a number or text
            None where it is missing and needn't be there.

        Raises
        ------
        InputError
            It is missing and required, of another shape or type, or holds what isn't allowed.
        """
        owner, mark, name = self.name.rpartition("@")
        place = group[owner] if owner else group
        if not self.required and name not in (place.attrs if mark else place):
            return None
        found, where = self._attribute(place, name, sizes) if mark else self._dataset(place, name, sizes)
        for axis, size in zip(self.shape.split(", "), found.shape, strict=False):
            if axis.isalpha():
                sizes.setdefault(axis, size)
        if self.kind == "text":
            return _text(found, where) if self.shape else _text(found.reshape(1), where)[0]
        if checked:
            self.hold(found, where)
        with np.errstate(over="ignore", invalid="ignore"):
            values = found.astype(self.kind, copy=False)
        return values if self.shape else values.item()

    def _dataset(self, group: h5py.Group, name: str, sizes: Mapping[str, int]) -> tuple[NDArray[Any], str]:
        """A dataset's values, and what errors call it."""
        shape = (getattr(group.get(name), "shape", None) or ()) if " or " in self.shape else ()
        values = get(group, name, self._wanted(shape, sizes), TEXT if self.kind == "text" else NUMBERS)
        return values, place_of(group, name)

    def _attribute(
        self, place: h5py.Group | h5py.Dataset, name: str, sizes: Mapping[str, int]
    ) -> tuple[NDArray[Any], str]:
        """An attribute's values, and what errors call it."""
        where = f"{os.fsdecode(h5py.h5f.get_name(place.id))}: {place.name}: {name}"
        if name not in place.attrs:
            unit = f", {self.shown_unit}" if self.shown_unit else ""
            raise InputError(where, "none", f"an attribute: {self.meaning}{unit}")
        values = np.asarray(place.attrs[name])
        if not self.shape and values.size == 1:
            values = values.reshape(())  # as MATLAB writes single numbers
        if not fits(values.shape, self._wanted(values.shape, sizes)):
            raise InputError(where, f"shape {values.shape}", f"shape ({self.shape})")
        if self.kind != "text" and values.dtype.kind not in NUMBERS:
            raise InputError(where, f"{values}"[:60], "numbers" if self.shape else "a number")
        return values, where

    def _wanted(self, found: tuple[int, ...], sizes: Mapping[str, int]) -> tuple[int | None, ...]:
        """The shape it has to have, None for a size that isn't known yet; of two sizes the one it has."""
        wanted: list[int | None] = []
        for place, axis in enumerate(self.shape.split(", ") if self.shape else ()):
            term = AXIS.fullmatch(axis)
            if term is None:
                choices = [int(size) for size in axis.split(" or ")]
                own = found[place] if place < len(found) else choices[0]
                wanted.append(own if own in choices else choices[0])
                continue
            factor, letter, more = term.groups()
            known = sizes.get(letter)
            wanted.append(None if known is None else int(factor or 1) * known + int(more or 0))
        return tuple(wanted)

    def hold(self, values: NDArray[Any], where: str) -> None:
        """Refuse the first number that isn't allowed.

        Raises
        ------
        InputError
            There is one; `where` is what it calls the values.
        """
        least, most = self._ends()
        if not values.size or (self.endless and self.nan and np.isinf([least, most]).all()):
            return
        low, high = values.min(), values.max()  # NaN if there is one; nothing else is made of a large array
        slack = ROUNDING if values.dtype.kind == "f" and not self.open else 0.0
        parts = self.kind in (*WHOLE, TRUTH) and values.dtype.kind == "f"  # perhaps of whole numbers
        inside = not self._beyond(np.array([low, high]), least - slack, most + slack).any()
        if inside and not parts and (self.endless or np.isfinite([low, high]).all()) and low <= high:
            return
        bad = self._beyond(values, least - slack, most + slack)
        bad |= (np.isnan(values) & (not self.nan)) | (np.isinf(values) & (not self.endless))
        if parts:
            bad |= values != np.floor(values)
        for index in np.argwhere(bad)[:1]:
            found = values[tuple(index)]
            place = f"[{', '.join(map(str, index))}]" if len(index) else ""
            usual = np.isfinite(found) or self.endless
            kind = "whole numbers, " if parts and self.kind != TRUTH else ""
            words = "finite numbers" if self._words == "finite" else f"{kind}{self._words}"
            unit = "" if "," in self.unit or np.isinf([least, most]).all() else f" {self.shown_unit}"
            raise InputError(
                f"{where}{place}", f"{found:.9g}" if usual else "NaN or infinity", f"{words}{unit}".strip()
            )

    def _beyond(self, values: NDArray[Any], least: float, most: float) -> NDArray[np.bool_]:
        return (values <= least) | (values >= most) if self.open else (values < least) | (values > most)

    def _ends(self) -> tuple[float, float]:
        """Least and most, as far as the type holds them."""
        if self.kind == TRUTH:
            return 0, 1
        top = {"int32": 2.0**31 - 1, "int64": 2.0**53}.get(self.kind, np.inf)
        return max(self.least, -top), min(self.most, top)


@dataclass(frozen=True)
class Group:
    """A group of an HDF5 file.

    Attributes
    ----------
    name : str
        Empty for the root.
    datasets : tuple of Dataset
        In the order in which they are written.
    absent : str
        What a file without it means; empty if it must be there.
    """

    name: str
    datasets: tuple[Dataset, ...]
    absent: str = ""

    def put(self, file: h5py.Group, values: Mapping[str, Any]) -> h5py.Group:
        """Write what is described, by name; what is None, or missing and needn't be there, is left out.

        Raises
        ------
        KeyError
            Something that is required is missing.
        """
        group = file.require_group(self.name) if self.name else file
        for one in self.datasets:
            value = values[one.name] if one.required else values.get(one.name)
            if value is not None:
                one.put(group, value)
        return group

    def get(
        self,
        file: h5py.Group,
        sizes: dict[str, int] | None = None,
        names: Collection[str] | None = None,
        checked: bool = True,
    ) -> dict[str, Any]:
        """Read what is described, by name; None where something is missing that needn't be there.

        Parameters
        ----------
        file : h5py.Group
        sizes : dict of int, optional
            See `Dataset.get`.
        names : collection of str, optional
            Of those to read; default: all but free ones.
        checked : bool

        Raises
        ------
        InputError
            As of `Dataset.get`; or there is no such group, and there has to be one.
        """
        known = {} if sizes is None else sizes
        wanted = [one for one in self.datasets if (one.name in names if names is not None else not one.free)]
        if self.absent and self.name not in file:
            return {one.name: None for one in wanted}
        group = subgroup(file, self.name) if self.name else file
        found: dict[str, Any] = {}
        for one in wanted:
            owner = one.name.rpartition("@")[0]
            found[one.name] = None if owner and owner not in group else one.get(group, known, checked)
        return found


@dataclass(frozen=True)
class Layout:
    """An HDF5 file of ours.

    Attributes
    ----------
    file : str
        What it is called in a run's folder.
    kind : str
        Root attribute ``format``.
    versions : tuple of int
        Root attribute ``version``.
    groups : tuple of Group
    """

    file: str
    kind: str
    versions: tuple[int, ...]
    groups: tuple[Group, ...]


def _text(values: NDArray[Any], where: str) -> tuple[str, ...]:
    try:
        words = [word.decode("utf-8") if isinstance(word, bytes) else word for word in values.tolist()]
    except UnicodeDecodeError:
        raise InputError(where, "bytes that aren't text", "text (UTF-8)") from None
    if not all(isinstance(word, str) for word in words):
        raise InputError(where, f"type {values.dtype}", "text")
    return tuple(words)
