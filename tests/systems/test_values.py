"""Values in files: what goes in comes out, of the type that is annotated, or not at all."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import h5py
import numpy as np
import pytest
from filter_states import state_of
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

from gridslam.errors import InputError
from gridslam.inference.beliefs.belief import Belief
from gridslam.inference.health.range_watch import RangeWatch
from gridslam.inference.state.surface_bank import SurfaceBank
from gridslam.systems.values import get_value, put_value


@dataclass(frozen=True, eq=False)
class Part:
    count: int
    share: float
    on: bool
    name: str


@dataclass(frozen=True, eq=False)
class Other:
    share: float


@dataclass(frozen=True, eq=False)
class Whole:
    table: NDArray[np.float64]
    signal: NDArray[np.complex128]
    index: NDArray[np.int32]
    mask: NDArray[np.bool_]
    part: Part | Other
    parts: tuple[Part, ...]
    pair: tuple[float, int]
    shares: tuple[float, ...]
    known: Mapping[tuple[int, int], tuple[NDArray[np.float64], float]]
    maybe: Part | None = None
    time_s: float | None = None
    holes: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0), metadata={"blank": True})


def through(value, kind):
    with h5py.File("memory", "w", driver="core", backing_store=False) as file:
        put_value(file, "it", value)
        return get_value(file, "it", kind)


def equal(one, two):
    if isinstance(one, np.ndarray):
        assert one.dtype == two.dtype
        np.testing.assert_array_equal(one, two)
    elif hasattr(one, "__dataclass_fields__"):
        assert type(one) is type(two)
        for name in one.__dataclass_fields__:
            equal(getattr(one, name), getattr(two, name))
    elif isinstance(one, tuple):
        assert len(one) == len(two)
        for here, there in zip(one, two, strict=True):
            equal(here, there)
    elif isinstance(one, Mapping):
        assert list(one) == list(two)
        equal(tuple(one.values()), tuple(two.values()))
    else:
        assert type(one) is type(two)
        assert one == two


finite = st.floats(allow_nan=False, allow_infinity=False)
part = st.builds(Part, st.integers(-9, 9), finite, st.booleans(), st.text("aé ", max_size=3))
table = arrays(np.float64, st.tuples(st.integers(0, 3), st.integers(0, 2)), elements=finite)
row = arrays(np.float64, 4, elements=finite)
signal = table.map(lambda x: np.clip(x, -1e9, 1e9) * (1 + 2j))
keys = st.tuples(st.integers(0, 9), st.integers(0, 9))
whole = st.builds(
    Whole,
    table,
    signal,
    arrays(np.int32, 3),
    arrays(bool, (2, 2)),
    part | st.builds(Other, finite),
    st.lists(part, max_size=3).map(tuple),
    st.tuples(finite, st.integers(0, 5)),
    st.lists(finite, max_size=3).map(tuple),
    st.dictionaries(keys, st.tuples(row, finite), max_size=3),
    st.none() | part,
    st.none() | finite,
    st.just(np.array([np.nan, 1.0])),
)


@pytest.mark.slow
@given(value=whole)
@settings(max_examples=60, deadline=None)
def test_what_goes_in_comes_out(value):
    equal(through(value, Whole), value)


PART = Part(1, 0.5, True, "x")


@pytest.mark.parametrize(
    ("value", "kind", "says"),
    [
        (PART, Other, "a Part"),
        (Other(1.0), Part | None, "a Other"),
        (Other(np.nan), Other, "finite"),
        (np.array([1.5]), NDArray[np.int64], "whole numbers"),
        (np.array([1]), NDArray[np.bool_], "true or false"),
        (np.array([1.5]), NDArray[np.complex128], "complex numbers"),
        (np.array([np.inf]), NDArray[np.float64], "finite"),
        ((1.0, 2.0, 3.0), tuple[float, float], "length"),
        (1.5, int, "int"),
        ("word", float, "float"),
        (None, float, "none"),
        (None, Part, "group"),
        (np.zeros(2), Part, "group"),
    ],
)
def test_what_is_of_another_type_is_refused(value, kind, says):
    with pytest.raises(InputError, match=says):
        through(value, kind)


def test_what_has_no_form_is_not_written():
    with pytest.raises(TypeError, match="set"):
        through({1}, Part)


def test_walks_of_surfaces_that_an_older_file_lacks_are_those_of_flat_walls():
    belief = Belief(np.append(np.zeros(5), [0.3, 4.0, 1.0, 2.0]), np.eye(9))
    bank = state_of(belief).surfaces
    bank = replace(bank, walk=np.full((2, 2), 0.7))
    equal(through(bank, SurfaceBank), bank)
    with h5py.File("memory", "w", driver="core", backing_store=False) as file:
        put_value(file, "it", bank)
        del file["it/walk"]
        np.testing.assert_array_equal(get_value(file, "it", SurfaceBank).walk, np.zeros((2, 2)))


def test_outermost_hits_that_an_older_file_lacks_are_not_known():
    bank = state_of(Belief(np.append(np.zeros(5), [0.3, 4.0]), np.eye(7))).surfaces
    bank = replace(bank, outermost=np.arange(8.0)[None])
    equal(through(bank, SurfaceBank), bank)
    with h5py.File("memory", "w", driver="core", backing_store=False) as file:
        put_value(file, "it", bank)
        del file["it/outermost"]
        assert np.isnan(get_value(file, "it", SurfaceBank).outermost).all()


def test_a_range_watch_of_an_older_file_has_no_doubt_yet():
    watch = replace(RangeWatch.start(2), doubt="too long")
    equal(through(watch, RangeWatch), watch)
    with h5py.File("memory", "w", driver="core", backing_store=False) as file:
        put_value(file, "it", watch)
        del file["it"].attrs["doubt"]
        assert get_value(file, "it", RangeWatch).doubt == ""
