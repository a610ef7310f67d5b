"""Reads an HDF5 file and keeps nothing: a program of its own, which `gridslam.io.hdf5_guard` starts.

``foreign_reader.py FILE LARGEST_DATASET MEMORY [NAME]...`` ends with 0 if all went well, with 1 and a line
that says why if the HDF5 library refused something. It imports nothing of this package: that would take
longer than the reading.
"""

import sys

import h5py


def limit(memory: int) -> None:
    """Bound what this process may take beyond the memory that it has, bytes (on Linux)."""
    try:
        import resource

        with open("/proc/self/statm") as sizes:
            taken = int(sizes.read().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (taken + memory,) * 2)
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    except (ImportError, OSError, ValueError):
        pass


def read(item: h5py.Group | h5py.Dataset | None, most: int) -> None:
    """Read a dataset (or nothing of a group), its attributes and what its cells refer to."""
    if item is None:
        return
    try:
        list(item.attrs.items())
        if isinstance(item, h5py.Dataset) and (item.external or item.is_virtual):
            return  # held by another file, which is nothing to read
        if isinstance(item, h5py.Dataset) and item.size and item.size * item.dtype.itemsize <= most:
            values = item[()]
            if h5py.check_ref_dtype(item.dtype) is h5py.Reference:
                for link in values.ravel():
                    read(item.file[link] if link else None, most)
    except (TypeError, ValueError, KeyError, RecursionError):
        pass  # types that can't be read: whoever needs them will be told


def inside(file: h5py.File, path: str) -> h5py.Group | h5py.Dataset | None:
    """What lies under a path in the file itself: links, which could lead out of it, aren't followed."""
    item = file
    for name in path.split("/"):
        if name:
            link = item.get(name, getlink=True) if isinstance(item, h5py.Group) else None
            if not isinstance(link, h5py.HardLink):
                return None
            item = item[name]
    return item


def main(path: str, most: str, memory: str, *names: str) -> None:
    """Read what is named, or all."""
    limit(int(memory))
    with h5py.File(path, "r") as file:
        read(file, int(most))
        if not names:
            file.visititems(lambda _, item: read(item, int(most)))
        for name in names:
            read(inside(file, name), int(most))


if __name__ == "__main__":
    try:
        main(*sys.argv[1:])
    except (OSError, RuntimeError, MemoryError, KeyError, ValueError, TypeError) as fault:
        sys.stdout.buffer.write((" ".join(str(fault).split())[:200] or type(fault).__name__).encode())
        sys.exit(1)
