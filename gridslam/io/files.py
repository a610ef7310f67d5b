"""Files that are either complete or absent, and HDF5 that is checked before it is believed."""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import h5py
import numpy as np

from gridslam.errors import InputError
from gridslam.io.foreign import refuse_foreign_h5
from gridslam.io.hdf5_guard import is_hdf5, prove, seal
from gridslam.io.hdf5_limits import claims_too_much, counted, most_claimed, place_of, refuse_links

OF_KINDS = {"OS": "text", "iu": "whole numbers", "b": "true or false", "c": "complex numbers"}
"""What datasets of some NumPy kinds hold, in words; of all others: numbers."""


def beside(path: Path) -> Path:
    """Temporary name in the folder of `path`, for a rename that can't cross file systems.

    Raises
    ------
    InputError
        It names no file.
    """
    if not path.name:
        raise InputError(str(path), "a folder", "the name of a file in it")
    return path.with_name(f".{path.name}.{os.getpid()}.part")


def cannot_write(path: Path, error: OSError) -> InputError:
    """Say in one line why nothing could be written."""
    return InputError(
        str(path), f"{error.strerror or error}", "a folder that can be written to, with space left"
    )


def refuse_taken(paths: Iterable[Path], overwrite: bool = False) -> None:
    """Refuse to replace files that a command would write, unless it was asked to.

    Raises
    ------
    InputError
        One is there and `overwrite` is off.
    """
    for path in paths:
        if (path.exists() or path.is_symlink()) and not overwrite:
            raise InputError(str(path), "something of this name", "a new name (or --overwrite)")


@contextmanager
def new_file(path: Path, overwrite: bool = False) -> Iterator[Path]:
    """A name to write a file under that gets its own once finished, unless another came there meanwhile.

    Raises
    ------
    InputError
        One is there and `overwrite` is off, before or after the work; or it can't be written.
    """
    refuse_taken([path], overwrite)
    part = beside(path)
    try:
        yield part
        if not overwrite:
            with contextlib.suppress(OSError):  # not all file systems have links
                os.link(part, path)
                settle_folder(path.parent)
                return
            refuse_taken([path])
        put_in_place(part, path)
    except OSError as error:
        raise cannot_write(path, error) from error
    except InputError as error:
        if error.where != str(part):
            raise
        raise InputError(str(path), error.found, error.allowed) from None
    finally:
        part.unlink(missing_ok=True)


def refuse_leaving(folder: Path, paths: Iterable[Path]) -> None:
    """Refuse links in a folder that lead out of it: folders are shared, and what they name isn't theirs.

    Raises
    ------
    InputError
        One of the paths in the folder leads elsewhere, or nowhere.
    """
    root = os.path.realpath(folder)
    for path in paths:
        if not Path(os.path.realpath(path)).is_relative_to(root):
            raise InputError(str(path), "a link that leads out of the folder", "files of the folder itself")


def put_in_place(part: Path, path: Path) -> None:
    """Give a finished file its name, replacing what had it: after a power loss it is the old one or the new.

    Raises
    ------
    OSError
        It can't be made durable or renamed; `part` is still there then.
    """
    with part.open("r+b") as file:  # Windows syncs only what may be written
        os.fsync(file.fileno())
    os.replace(part, path)
    settle_folder(path.parent)


def settle_folder(directory: Path) -> None:
    """Make the names in a folder durable, where folders can be synced."""
    with contextlib.suppress(OSError):
        handle = os.open(directory, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def write_bytes(path: str | os.PathLike[str], content: bytes) -> None:
    """Write a file under a temporary name in its folder, make it durable, then rename it.

    Raises
    ------
    InputError
        The folder is missing or read-only, or the disk is full; nothing is left behind.
    """
    path = Path(path)
    part = beside(path)
    try:
        try:
            part.write_bytes(content)
            put_in_place(part, path)
        finally:
            part.unlink(missing_ok=True)
    except OSError as error:
        raise cannot_write(path, error) from error


def write_files(
    folder: Path, contents: Mapping[str, bytes], faults: list[InputError] | None = None
) -> list[Path]:
    """Write files of a folder, which is made if need be; they are written aside and then get their names.

    Parameters
    ----------
    folder : Path
        One whose parent is there; other files in it stay.
    contents : mapping of str to bytes
        By name.
    faults : list of InputError, optional
        Takes those of single files, which then don't cost the others.

    Returns
    -------
    list of Path
        Those that were written.

    Raises
    ------
    InputError
        The folder is read-only, or the disk is full; no file is left behind, and none is replaced.
    """
    part, alone = beside(folder), list[InputError]()
    try:
        try:
            shutil.rmtree(part, ignore_errors=True)
            part.mkdir()
            whole = []
            for name, content in contents.items():
                try:
                    (part / name).write_bytes(content)
                    whole.append(name)
                except OSError as error:
                    alone.append(cannot_write(folder / name, error))
                    if faults is None or len(alone) == len(contents):  # not one file, but the disk
                        raise
            folder.mkdir(exist_ok=True)
            for name in whole.copy():
                try:
                    put_in_place(part / name, folder / name)
                except OSError as error:
                    if faults is None:
                        raise
                    alone.append(cannot_write(folder / name, error))
                    whole.remove(name)
        finally:
            shutil.rmtree(part, ignore_errors=True)
    except OSError as error:
        raise cannot_write(folder, error) from error
    if faults is not None:
        faults += alone
    return [folder / name for name in whole]


@contextmanager
def writing_h5(path: str | os.PathLike[str], kind: str, version: int = 1) -> Iterator[h5py.File]:
    """Open an HDF5 file to fill; it appears under its name when the block ends well.

    It is built in memory: HDF5 doesn't survive a full disk in good order, plain bytes do.

    Parameters
    ----------
    path : path
    kind : str
        Root attribute ``format``.
    version : int
        Root attribute ``version``.

    Raises
    ------
    InputError
        A file of another kind has this name, or it can't be written.
    """
    refuse_foreign_h5(path, kind)
    # the format of HDF5 1.8 on has checksums, without which a damaged file can hang the library
    layout = ("v108", "v108")
    with h5py.File(str(path), "w", driver="core", backing_store=False, libver=layout) as file:
        file.attrs["format"], file.attrs["version"] = kind, version
        yield file
        file.flush()
        image = file.id.get_file_image()
    write_bytes(path, image + seal(image))


def put(group: h5py.Group, name: str, values: np.ndarray, unit: str) -> None:
    """Write one dataset with its ``unit`` attribute, packed when it is large."""
    values = np.asarray(values)
    packed = {"compression": "gzip", "compression_opts": 4, "shuffle": True} if values.size > 1000 else {}
    group.create_dataset(name, data=values, **packed).attrs["unit"] = unit


MEANT = {
    "gridslam-signal": "; sampled signals go in by --signal, and gridslam extract makes paths of them",
    "gridslam-measurements": "; measured paths go in by --measurements, for methods on paths",
    "gridslam-map": "; maps go in by --map",
}
"""What to do with a file of a format that isn't taken where it was given."""


@contextmanager
def reading_h5(
    path: str | os.PathLike[str], kind: str, version: int | tuple[int, ...] = 1
) -> Iterator[h5py.File]:
    """Open an HDF5 file to read, checking that it is what it should be, of one of the versions.

    Raises
    ------
    InputError
        No such file, not HDF5, cut short, another format or version, links in it, or damaged inside.
    """
    if not Path(path).is_file():
        raise InputError(str(path), "no file", f"a {kind} file")
    try:
        if not is_hdf5(path):
            found = f"a {f'{Path(path).suffix} file'.strip()} without HDF5 in it"
            raise InputError(str(path), found, f"a {kind} file (.h5)")
        prove(path, most_claimed(path))
        with h5py.File(path, "r") as file, counted(file):
            refuse_links(file)
            found = _text(file.attrs.get("format", "no format attribute"))
            if found != kind:
                raise InputError(f"{path}: format", found, kind + MEANT.get(found, ""))
            versions = version if isinstance(version, tuple) else (version,)
            if file.attrs.get("version") not in versions:
                allowed = " or ".join(map(str, versions))
                raise InputError(f"{path}: version", _text(file.attrs.get("version")), allowed)
            yield file
    except InputError:
        raise
    except (OSError, KeyError, RuntimeError, ValueError, TypeError) as error:
        reason = " ".join(str(error).split())[:120]
        raise InputError(
            str(path), f"damaged or incomplete HDF5 ({reason})", f"a whole {kind} file"
        ) from error


def subgroup(file: h5py.Group, name: str) -> h5py.Group:
    """Return a group that must be there.

    Raises
    ------
    InputError
        There is none of this name.
    """
    group = file.get(name)
    if not isinstance(group, h5py.Group):
        raise InputError(f"{file.file.filename}: /{name}", "no group", "a group of this name")
    return group


def get(group: h5py.Group, name: str, shape: tuple[int | None, ...], kind: str = "fiub") -> np.ndarray:
    """Read one dataset of the given shape (None: any length).

    Raises
    ------
    InputError
        The dataset is missing, has another shape or type, or claims an absurd size, alone or with
        those read before.
    """
    data = group.get(name)
    if not isinstance(data, h5py.Dataset):
        raise InputError(place_of(group, name), "no dataset", "a dataset of this name")
    if not fits(data.shape or (), shape):
        wanted = tuple("any" if n is None else n for n in shape)
        raise InputError(place_of(group, name), f"shape {data.shape}", f"shape {wanted}".replace("'", ""))
    if data.dtype.kind not in kind:
        raise InputError(place_of(group, name), f"type {data.dtype}", OF_KINDS.get(kind, "numbers"))
    if claims_too_much(data):
        raise InputError(place_of(group, name), f"{data.size} values", "as many as the file holds")
    return np.asarray(data[()])


def fits(found: tuple[int, ...], wanted: tuple[int | None, ...]) -> bool:
    """Whether a shape is the wanted one, of which None stands for any size."""
    return len(found) == len(wanted) and all(
        want in (None, size) for want, size in zip(wanted, found, strict=True)
    )


def put_attributes(group: h5py.Group, values: Mapping[str, object]) -> None:
    """Write attributes; lists of text as variable-length strings."""
    for name, value in values.items():
        if isinstance(value, list | tuple) and (not value or isinstance(value[0], str)):
            group.attrs.create(name, list(value), dtype=h5py.string_dtype(), shape=(len(value),))
        else:
            group.attrs[name] = value


def get_attributes(group: h5py.Group) -> dict[str, str | int | float | list]:
    """Read attributes as plain Python values."""
    return {name: _plain(value) for name, value in group.attrs.items()}


def _plain(value: object) -> str | int | float | list:
    if isinstance(value, np.ndarray):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        return value.item()
    return _text(value)


def _text(value: object) -> str:
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)
