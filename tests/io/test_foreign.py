"""HDF5 that isn't known to be whole: tried elsewhere first, so that it can't stop this process."""

import resource
import struct
from types import SimpleNamespace

import h5py
import numpy as np
import pytest
from tables import same, table

from gridslam.errors import InputError
from gridslam.io import hdf5_guard
from gridslam.measurements.hdf5_table import KIND
from gridslam.measurements.table import Measurements

HERE = Measurements(**table(8))


@pytest.fixture
def ours(tmp_path):
    HERE.to_h5(tmp_path / "ours.h5")
    return tmp_path / "ours.h5"


@pytest.fixture
def theirs(tmp_path, ours):
    """The same in the layout of HDF5 1.6, which knows no checksums."""
    with h5py.File(ours) as old, h5py.File(tmp_path / "theirs.h5", "w") as new:
        new.attrs.update(old.attrs)
        for name in old:
            old.copy(name, new)
    return tmp_path / "theirs.h5"


def change(path, at, new):
    content = bytearray(path.read_bytes())
    content[at : at + len(new)] = new
    path.write_bytes(content)


def test_files_of_both_are_read_and_only_those_of_others_in_another_process(ours, theirs, monkeypatch):
    same(Measurements.from_h5(theirs), Measurements.from_h5(ours))
    monkeypatch.setattr(hdf5_guard.subprocess, "run", lambda *_, **__: SimpleNamespace(returncode=-11))
    same(Measurements.from_h5(ours), HERE)
    with pytest.raises(InputError, match="crashes the HDF5 library"):
        Measurements.from_h5(theirs)


def test_any_changed_byte_of_ours_is_noticed_even_in_the_numbers(ours):
    with h5py.File(ours) as file:
        at = file["measurements/distance_m"].id.get_offset()
    content = ours.read_bytes()
    for place in (0, 9, at + 3, len(content) - 30, len(content) - 1):
        change(ours, place, bytes([content[place] ^ 2]))
        with pytest.raises(InputError, match=r"ours\.h5"):
            Measurements.from_h5(ours)
        ours.write_bytes(content)
    assert len(Measurements.from_h5(ours)) == len(HERE)


def test_ours_after_a_change_by_another_program_is_read(ours):
    with h5py.File(ours, "r+") as file:
        file["measurements/distance_m"][0] = 2.5
    assert Measurements.from_h5(ours).distance_m[0] == 2.5


@pytest.mark.slow
def test_endless_loop_of_the_library_ends(theirs, monkeypatch):
    """One wrong bit in the length of a text: h5py 3.16 with HDF5 2.0 never comes back from it."""
    monkeypatch.setattr(hdf5_guard, "START_S", 1.5)
    change(theirs, theirs.read_bytes().index(b"GCOL") + 25, b"\x02")
    with pytest.raises(InputError, match=r"theirs\.h5"):
        Measurements.from_h5(theirs)


def test_text_that_claims_gigabytes_takes_none(theirs):
    with h5py.File(theirs) as file:
        at = file["anchors/name"].id.get_offset()
    change(theirs, at, struct.pack("<I", 2**32 - 8))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(InputError, match=r"theirs\.h5"):
        Measurements.from_h5(theirs)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss < before + 100_000


def test_numbers_that_lie_in_another_file_are_not_read(tmp_path, theirs):
    (tmp_path / "secret").write_bytes(np.arange(1.0, 9.0).tobytes())
    with h5py.File(theirs, "r+") as file:
        rows = file["measurements"]
        del rows["distance_m"]
        rows.create_dataset("distance_m", (8,), "f8", external=[(str(tmp_path / "secret"), 0, 64)])
    with pytest.raises(InputError, match="distance_m"):
        Measurements.from_h5(theirs)


@pytest.mark.slow
def test_large_table_of_others_is_read(tmp_path):
    """Not refused by the limits that guard against absurd ones."""
    count = 300_000
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.attrs["format"], file.attrs["version"] = KIND, 1
        rows = file.create_group("measurements")
        for name, values in (("step", np.arange(count)), ("anchor", np.zeros(count, int))):
            rows.create_dataset(name, data=values, compression="gzip")
        rows["time_s"], rows["distance_m"] = np.arange(float(count)), np.ones(count)
        file["anchors/name"] = ["A"]
    assert len(Measurements.from_h5(tmp_path / "a.h5")) == count
