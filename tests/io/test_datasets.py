"""HDF5 files hold what is described, and readers hold them to it, in a line that names what is off."""

import shutil

import h5py
import numpy as np
import pytest
from described_files import FILES, LAYOUTS, write_all

from gridslam.errors import InputError
from gridslam.io.datasets import ROUNDING, Dataset, Group
from gridslam.io.hdf5_guard import seal
from gridslam.maps.map_files import PICTURES

TRACKS = {"measurements of one": ("/truth",), "measurements": ("/truth/me", "/truth/you")}
"""Where true tracks stand."""
MORE = {
    "surfaces/joint_covariance", "levels/floor", "levels/ceiling", "@anchors", "measurements@unlabelled",
    "measurements/step", "measurements/time_s", "measurements/anchor", "measurements/agent",
    "measurements/distance_m", "agents/present", "measurements@steps", "signal/time_s", "signal/frequency_hz",
    "signal/pulse", "truth/time_s", "truth/clocks/time_s", "anchors/element_m", "agent/element_m",
    "grid/coefficient_cell", "surfaces/stretch_surface", "features/anchor", "signal/heard",
}  # fmt: skip
"""Held to more than a range: to the other rows, to what else is in the file, or to what can be."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return write_all(tmp_path_factory.mktemp("described"))


def contents(path):
    """Names of all datasets and attributes as descriptions have them, and the items themselves."""
    found = {}
    with h5py.File(path) as file:

        def see(name, item):
            for key in item.attrs:
                if key not in ("unit", "format", "version"):
                    mark = "" if isinstance(item, h5py.Group) else "dataset"
                    found[f"{name}@{key}"] = mark
            if isinstance(item, h5py.Dataset):
                shown = item.dtype.name if item.dtype.kind != "O" else "text"
                found[name] = (shown, item.attrs["unit"], item.shape)

        file.visititems(see)
        see("", file)
    return found


def described(layout, tracks=("/truth",)):
    """Every description by its whole name."""
    found = {}
    for group in layout.groups:
        for one in group.datasets:
            for name in [part[1:] for part in tracks] if group.name == "truth" else [group.name]:
                found[f"{name}/{one.name}".lstrip("/").replace("/@", "@")] = one
    return found


@pytest.mark.parametrize("name", FILES)
def test_what_is_written_is_what_is_described(folder, name):
    layout, said = FILES[name][0], described(FILES[name][0], TRACKS.get(name, ("/truth",)))
    held = contents(folder / f"{name}.h5")
    assert held.keys() <= said.keys()
    for key, item in held.items():
        if "@" not in key:
            kind, unit, shape = item
            assert (kind, unit) == (said[key].kind, said[key].unit), key
            assert len(shape) == len(said[key].shape.split(", ")), key
    left = {key for key, one in said.items() if key not in held}
    if name != "measurements of one":
        assert left == set(), "described, and never written"
    assert not {key for key in left if said[key].required and not _group(layout, key).absent}


def _group(layout, key):
    return next(group for group in layout.groups if key.replace("@", "/").startswith(group.name))


def ends(one):
    """Numbers that it may be, and some that it mayn't."""
    if one.kind == "bool":
        return [0, 1], [2, 0.5]
    step = 1 if one.kind.startswith("int") else 0.1
    limits = [(end, sign) for end, sign in ((one.least, -1), (one.most, 1)) if np.isfinite(end)]
    good = [end for end, _ in limits if not one.open]
    bad = [end + sign * step for end, sign in limits] + [end for end, _ in limits if one.open]
    bad += [0.5] if one.kind.startswith("int") else []
    bad += [] if one.nan else [np.nan]
    return good, bad + ([] if one.endless else [np.inf])


def put_value(path, source, key, value, place):
    """A copy of a file with a number changed, stored in a type that holds it; whether it was there."""
    shutil.copyfile(source, path)
    with h5py.File(path, "r+") as file:
        owner, mark, attribute = key.partition("@")
        if (owner or "/") not in file:
            return False
        item = file[owner or "/"]
        if mark and attribute not in item.attrs:
            return False
        if not mark and (key not in file or not file[key].size):
            return False
        old = np.array(item.attrs[attribute] if mark else item[()], float)
        old.reshape(-1)[int(place * old.size)] = value
        if mark:
            item.attrs[attribute] = old[()]
        else:
            unit = item.attrs["unit"]
            attributes = dict(item.attrs)
            del file[key]
            file[key] = old
            file[key].attrs.update(attributes | {"unit": unit})
    path.write_bytes(path.read_bytes() + seal(path.read_bytes()))  # read without another process
    return True


NUMBERS = [
    (name, key, one)
    for name in LAYOUTS
    for key, one in described(LAYOUTS[name], TRACKS.get(name, ("/truth",))).items()
    if one.kind != "text" and not one.free and not (one.nan and one.endless and np.isinf(one.least))
]
"""Every number of a file that is held to something."""


@pytest.mark.slow
@pytest.mark.parametrize(("name", "key", "one"), NUMBERS, ids=[f"{name} {key}" for name, key, _ in NUMBERS])
def test_numbers_are_held_to_what_is_described(tmp_path, folder, name, key, one):
    good, bad = ends(one)
    if name == "map" and key.partition("/")[2] in PICTURES:
        return  # not read beside the evidence: see below
    if (name, key) == ("measurements", "measurements/distance_m"):
        bad = [value for value in bad if not np.isfinite(value)]  # offsets of clocks are in them
    path, source, read = tmp_path / "a.h5", folder / f"{name}.h5", FILES[name][2]
    for value in bad:
        if put_value(path, source, key, value, 0.999):  # at the end: whatever looks at the first alone fails
            with pytest.raises(InputError) as caught:
                read(path)
            assert key.replace("@", "/").rpartition("/")[2] in caught.value.where, (str(caught.value), value)
            assert "\n" not in str(caught.value)
    more = key in MORE or key.endswith("/offset")
    for value in [] if more else good:
        if put_value(path, source, key, value, 0.0):
            read(path)


@pytest.mark.parametrize("name", PICTURES)
def test_pictures_of_other_programs_are_held_to_it_where_they_are_read(tmp_path, folder, name):
    source, path = tmp_path / "other.h5", tmp_path / "a.h5"
    shutil.copyfile(folder / "map.h5", source)
    with h5py.File(source, "r+") as file:
        del file["grid/evidence"]
    for value, right in (
        (0.0, True),
        (1.0, True),
        (np.nan, True),
        (1.1, False),
        (-0.1, False),
        (np.inf, False),
    ):
        assert put_value(path, source, f"grid/{name}", value, 0.5)
        if right:
            FILES["map"][2](path)
        else:
            with pytest.raises(InputError, match=rf"/grid/{name}\[2, 0\]"):
                FILES["map"][2](path)


@pytest.mark.parametrize("name", FILES)
def test_shapes_are_held_to_what_is_described(tmp_path, folder, name):
    """A dataset with an entry too many along an axis whose size something else tells, or none."""
    path, read = tmp_path / "a.h5", FILES[name][2]
    tried = 0
    for key, one in described(LAYOUTS[name], TRACKS.get(name, ("/truth",))).items():
        shutil.copyfile(folder / f"{name}.h5", path)
        with h5py.File(path, "r+") as file:
            if "@" in key or key not in file or (name == "map" and one.default.startswith("needed without")):
                continue
            values = file[key][()]
            attributes = dict(file[key].attrs)
            del file[key]
            file[key] = values[..., None]  # an axis that isn't described
            file[key].attrs.update(attributes)
        path.write_bytes(path.read_bytes() + seal(path.read_bytes()))
        tried += 1
        with pytest.raises(InputError) as caught:
            read(path)
        assert f"/{key}" in caught.value.where
        assert "shape" in caught.value.found
    assert tried > 5


@pytest.fixture
def group(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        yield file.create_group("place")


def test_letters_of_shapes_stand_for_the_same_size(group):
    sizes = {}
    group["few"], group["square"], group["next"], group["more"] = (
        np.ones(3),
        np.eye(6),
        np.ones(4),
        np.ones(5),
    )
    Dataset("few", "1", "", shape="N").get(group, sizes)
    assert sizes == {"N": 3}
    for name, shape in (("square", "2 N, 2 N"), ("next", "N + 1"), ("square", "N, 2 or 6"), ("more", "N")):
        if (name, shape) in (("square", "2 N, 2 N"), ("next", "N + 1")):
            assert Dataset(name, "1", "", shape=shape).get(group, sizes).shape == group[name].shape
        else:
            with pytest.raises(InputError, match=rf"a\.h5: /place/{name}: found shape .*; allowed: .*3"):
                Dataset(name, "1", "", shape=shape).get(group, sizes)


def test_whole_numbers_may_be_stored_as_doubles_and_fractions_are_named(group):
    """As MATLAB's h5create does unless it is told otherwise."""
    group["count"], group["part"], group["far"] = [1.0, 2.0], [1.0, 2.5], [1.0, 1e300]
    whole = Dataset("count", "1", "", least=0, shape="N", kind="int64").get(group, {})
    assert (whole.dtype, whole.tolist()) == (np.int64, [1, 2])
    for name, found in (("part", "2.5"), ("far", "1e\\+300")):
        with pytest.raises(
            InputError, match=rf"/place/{name}\[1\]: found {found}; allowed: whole numbers, 0 or"
        ):
            Dataset(name, "1", "", least=0, shape="N", kind="int64").get(group, {})


def test_rounding_beyond_an_end_is_none_of_anybodys_business(group):
    group["share"] = [1 + 0.5 * ROUNDING, -0.5 * ROUNDING]
    one = Dataset("share", "1", "", least=0, most=1, shape="N")
    assert len(one.get(group, {})) == 2
    group["share"][0] = 1 + 2 * ROUNDING
    with pytest.raises(InputError, match=r"/place/share\[0\]: found 1.000002; allowed: 0 to 1"):
        one.get(group, {})
    assert one.get(group, {}, checked=False)[0] > 1


def test_attributes_are_numbers_lists_or_text(group):
    group.attrs["width_m"], group.attrs["pair"], group.attrs["word"] = [0.5], [1.0, 2.0], "yes"
    assert Dataset("@width_m", "m", "").get(group, {}) == 0.5  # MATLAB writes a number as a row of one
    assert Dataset("@pair", "m", "", shape="2").get(group, {}).tolist() == [1.0, 2.0]
    assert Dataset("@word", "1", "", kind="text").get(group, {}) == "yes"
    assert Dataset("@none", "1", "", "nothing").get(group, {}) is None
    for name, found in (("pair", r"shape \(2,\)"), ("word", "yes"), ("none", "none")):
        with pytest.raises(InputError, match=rf"a\.h5: /place: {name}: found {found}"):
            Dataset(f"@{name}", "m", "how wide").get(group, {})


def test_text_is_text(group):
    group["name"] = np.array([b"A", b"\xff"])
    with pytest.raises(InputError, match="bytes that aren't text"):
        Dataset("name", "text", "", shape="N", kind="text").get(group, {})
    group["number"] = np.arange(2)
    with pytest.raises(InputError, match="type int64; allowed: text"):
        Dataset("number", "text", "", shape="N", kind="text").get(group, {})


def test_a_group_that_may_be_missing_has_nothing_in_it(group):
    rows = (Dataset("few", "1", "", shape="N"), Dataset("@width_m", "m", "", "1"))
    assert Group("none", rows, "nobody").get(group) == {"few": None, "@width_m": None}
    with pytest.raises(InputError, match="/none: found no group"):
        Group("none", rows).get(group)
    with pytest.raises(KeyError):
        Group("some", rows).put(group, {"@width_m": 2.0})


@pytest.mark.parametrize(
    ("limits", "words"),
    [
        ({}, "finite"),
        ({"least": 0}, "0 or more"),
        ({"least": 0, "open": True}, "above 0"),
        ({"least": 0, "most": 1, "open": True}, "above 0, below 1"),
        ({"least": -np.pi, "most": 2 * np.pi}, "-pi to 2 pi"),
        ({"least": 0, "most": 1, "nan": "silence"}, "0 to 1; NaN: silence"),
        ({"nan": "silence", "endless": True}, "any number; NaN: silence"),
        ({"kind": "bool"}, "true or false"),
        ({"kind": "text", "free": True}, "text, not checked"),
    ],
)
def test_what_is_allowed_is_said_in_words(limits, words):
    assert Dataset("x", "m", "", **limits).allowed == words
