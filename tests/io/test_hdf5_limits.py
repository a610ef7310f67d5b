"""HDF5 of others: nothing is read from other files, and no more in all than memory should hold."""

import h5py
import numpy as np
import pytest
from map_samples import random_map
from tables import same, table

from gridslam.errors import InputError
from gridslam.io import hdf5_limits
from gridslam.io.hdf5_guard import seal
from gridslam.maps.map import Map
from gridslam.measurements.table import Measurements

HERE = Measurements(**table(8))
LINKS = {
    "external": lambda path: h5py.ExternalLink(path, "/measurements/distance_m"),
    "soft, out by way of another": lambda path: h5py.SoftLink("/way/measurements/distance_m"),
    "soft, to nothing": lambda path: h5py.SoftLink("/nothing"),
}


@pytest.mark.slow
@pytest.mark.parametrize("sealed", [True, False], ids=["as if ours", "of others"])
@pytest.mark.parametrize("kind", LINKS)
@pytest.mark.parametrize("place", ["measurements/distance_m", "measurements/aod_std_rad", "odd"])
def test_links_are_refused_wherever_they_lead(tmp_path, kind, place, sealed):
    HERE.to_h5(tmp_path / "secret.h5")
    HERE.to_h5(tmp_path / "a.h5")
    with h5py.File(tmp_path / "a.h5", "r+") as file:
        if place in file:
            del file[place]
        if "another" in kind:
            file["way"] = h5py.ExternalLink(str(tmp_path / "secret.h5"), "/")
        file[place] = LINKS[kind](str(tmp_path / "secret.h5"))
    if sealed:
        content = (tmp_path / "a.h5").read_bytes()
        (tmp_path / "a.h5").write_bytes(content + seal(content))
    with pytest.raises(InputError, match=r"a\.h5.*link"):
        Measurements.from_h5(tmp_path / "a.h5")


def test_link_for_a_whole_group_of_a_map_is_refused(tmp_path):
    random_map(1).save(tmp_path / "secret.h5")
    random_map(2).save(tmp_path / "a.h5")
    with h5py.File(tmp_path / "a.h5", "r+") as file:
        del file["grid"]
        file["grid"] = h5py.ExternalLink(str(tmp_path / "secret.h5"), "/grid")
    with pytest.raises(InputError, match=r"a\.h5: /grid.*link"):
        Map.load(tmp_path / "a.h5")


@pytest.mark.parametrize("place", ["measurements", "measurements/distance_m"])
def test_links_in_a_matlab_file_are_refused(tmp_path, place):
    HERE.to_h5(tmp_path / "secret.h5")
    with (
        h5py.File(tmp_path / "secret.h5") as old,
        h5py.File(tmp_path / "a.mat", "w", userblock_size=512) as new,
    ):
        old.copy("measurements", new)
        new["measurements/anchor"][...] += 1
        del new[place]
        new[place] = h5py.ExternalLink(str(tmp_path / "secret.h5"), f"/{place}")
    with open(tmp_path / "a.mat", "r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file".ljust(512))
    with pytest.raises(InputError, match=r"a\.mat.*link"):
        Measurements.from_mat(tmp_path / "a.mat")


@pytest.mark.slow
def test_sum_of_what_is_read_from_a_file_is_limited(tmp_path, monkeypatch):
    """Each dataset may be as large as it is, all together not; one under many names counts every time."""
    count = 5000
    long = Measurements(**table(count))
    long.to_h5(tmp_path / "a.h5")
    whole = 8 * 8 * count  # bytes: keys, values, and names of the anchors in a few more
    monkeypatch.setattr(hdf5_limits, "LARGEST_SUM_BYTES", 2 * whole)
    for _ in range(3):  # every reading has the sum to itself
        same(Measurements.from_h5(tmp_path / "a.h5"), long)
    monkeypatch.setattr(hdf5_limits, "LARGEST_SUM_BYTES", whole // 2)
    with pytest.raises(InputError, match=r"a\.h5.*as many as the file holds"):
        Measurements.from_h5(tmp_path / "a.h5")
    with h5py.File(tmp_path / "a.h5", "r+") as file:
        rows = file["measurements"]
        for name in ("aod_rad", "aoa_rad", "amplitude"):
            del rows[name]
            rows[name] = rows["distance_m"]
    with pytest.raises(InputError, match=r"a\.h5.*as many as the file holds"):
        Measurements.from_h5(tmp_path / "a.h5")
    monkeypatch.setattr(hdf5_limits, "LARGEST_SUM_BYTES", 2 * whole)
    assert np.array_equal(Measurements.from_h5(tmp_path / "a.h5").amplitude, long.distance_m)
