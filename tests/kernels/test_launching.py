"""Quick launches of kernels: tried against plain ones first, and given up where anything differs."""

import ctypes
import importlib
import inspect
import sys
import warnings
from types import ModuleType

import numpy as np
import pytest


@pytest.fixture
def launching(monkeypatch):
    """The module, as it is before the first launch of a process."""
    from gridslam.kernels.primitives import launching

    monkeypatch.setattr(launching, "_verdict", [])
    return launching


def launched(launching):
    """A kernel launched quickly if that agrees, what it makes, and how often something was handed over."""
    handed, real = [], launching._hand_over
    kernel, attempts = launching._sample(), launching._attempts()
    quick = launching.quick(kernel)
    out = launching._made(quick, attempts[:1])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(launching, "_hand_over", lambda *given: handed.append(given) or real(*given))
        assert launching._made(quick, attempts) == launching._made(launching._plain(kernel), attempts)
    assert out == launching._made(launching._plain(kernel), attempts[:1])
    return len(handed)


def test_quick_launches_agree_with_this_taichi_and_are_tried_once(launching, monkeypatch):
    assert launched(launching) > 20
    assert launching._verdict == [True]
    monkeypatch.setattr(launching, "_sample", lambda: pytest.fail("tried again"))
    assert launching.agrees()


def other_numbers(launching, monkeypatch):
    real = launching._hand_over

    def hand_over(context, handed, number, slot, value):
        return real(context, handed, number, slot, 2 * value if type(value) is float else value)

    monkeypatch.setattr(launching, "_hand_over", hand_over)


def stale_arrays(launching, monkeypatch):
    """An array is taken for unchanged, though it is another one."""
    real = launching._hand_over

    def hand_over(context, handed, number, slot, value):
        if number == 2 and handed[2] is not launching.NOTHING and value.shape == handed[2].shape:
            return True
        return real(context, handed, number, slot, value)

    monkeypatch.setattr(launching, "_hand_over", hand_over)


def stale_shapes(launching, monkeypatch):
    """An array is taken for one of the shape before."""
    real = launching._hand_over

    def hand_over(context, handed, number, slot, value):
        if number == 2 and handed[2] is not launching.NOTHING:
            handed[2] = value
        return real(context, handed, number, slot, value)

    monkeypatch.setattr(launching, "_hand_over", hand_over)


def no_such_method(launching, monkeypatch):
    def refuse(*_):
        raise AttributeError("no such method")

    monkeypatch.setattr(launching, "_ReusedLaunch", refuse)


def another_order(launching, monkeypatch):
    def refuse(*_):
        raise TypeError("incompatible function arguments")

    monkeypatch.setattr(launching, "_hand_over", refuse)


def nothing_happens(launching, monkeypatch):
    monkeypatch.setattr(launching, "_hurrying", lambda kernel: lambda *arguments: None)


def other_source(launching, monkeypatch):
    """A kernel that is read quickly is another one."""
    from gridslam.kernels.primitives import taichi_inside

    def sources(find):
        def changed(thing):
            lines, start = find(thing)
            return [line.replace("anchor + factor", "anchor - factor") for line in lines], start

        return changed

    monkeypatch.setattr(taichi_inside, "_sources", sources)


BROKEN = [
    other_source,
    other_numbers,
    stale_arrays,
    stale_shapes,
    no_such_method,
    another_order,
    nothing_happens,
]


@pytest.mark.parametrize("broken", BROKEN)
def test_a_taichi_that_does_otherwise_is_launched_plainly_and_says_so_once(launching, monkeypatch, broken):
    with monkeypatch.context() as patch:
        broken(launching, patch)
        with pytest.warns(RuntimeWarning, match=r"Taichi 1\.7\.\d.*twice as long: "):
            assert not launching.agrees()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert launched(launching) == 0
    assert launching._verdict == [False]


def test_a_taichi_that_launches_nothing_is_no_verdict(launching, monkeypatch):
    def sample():
        def kernel(*_):
            raise RuntimeError("no device")

        kernel._primal = real._primal
        return kernel

    real = launching._sample()
    with monkeypatch.context() as patch:
        patch.setattr(launching, "_sample", sample)
        with pytest.raises(RuntimeError, match="no device"):
            launching.agrees()
    assert launching._verdict == []
    assert launching.agrees()


def test_nothing_reads_the_memory_of_objects(launching):
    source = inspect.getsource(launching)
    assert "from_address" not in source
    assert "id(" not in source.replace("valid(", "")
    assert ctypes not in vars(launching).values()


def test_arrays_that_begin_later_or_may_not_be_written_to_are_read_where_they_are(launching):
    kernel = launching.quick(launching._sample())
    wide, narrow, whole = np.arange(12.0).reshape(4, 3), np.ones(3, np.float32), np.arange(4, dtype=np.int32)
    narrow.flags.writeable = False
    side = np.zeros((4, 2))
    for start in range(4):
        out = np.zeros((4 - start, 3))
        for _ in range(2):
            kernel(1, 2.0, wide[start:], (narrow, whole[start:]), side[start:], out)
        np.testing.assert_array_equal(out, 1 + 2 * wide[start:] + whole[start:, None])


def test_what_is_only_read_is_copied_and_never_stale(launching, monkeypatch):
    handed, real = [], launching._hand_over
    monkeypatch.setattr(launching, "_hand_over", lambda *given: handed.append(given[2]) or real(*given))
    kernel = launching.copying("wide", "thin")(launching._sample())
    plain = launching._plain(launching._sample())
    wide, narrow, whole = np.arange(12.0).reshape(4, 3), np.ones(3, np.float32), np.arange(4, dtype=np.int32)
    fixed = np.ones((4, 3))[::-1]
    fixed.flags.writeable = False
    side, out = np.ones((4, 2)), np.zeros((4, 3))
    for given in (wide, wide, wide + 1, wide, fixed, wide[:2], wide):
        handed.clear()
        made, expected = out[: len(given)], np.zeros((len(given), 3))
        kernel(1, 2.0, given, (narrow.copy(), whole.copy()), side, made)
        plain(1, 2.0, np.array(given, float), (narrow, whole), side, expected)
        np.testing.assert_array_equal(made, expected)
        if given.flags.writeable:
            given += 1.0  # in place, of the same object
    with pytest.raises(ValueError, match="f32"):
        kernel(1, 2.0, wide.astype(np.float32), (narrow, whole), side, out)
    kernel(1, 2.0, wide, (narrow, whole), side, out)
    handed.clear()
    kernel(1, 2.0, wide.copy(), (narrow.copy(), whole.copy()), side, out)
    assert handed == []


class Asked(ModuleType):
    """A module that counts how often somebody looks at where it stands."""

    times = 0

    def __getattribute__(self, name):
        Asked.times += name == "__file__"
        return super().__getattribute__(name)


def test_importing_kernels_does_not_walk_through_all_modules_at_each_decorator(tmp_path, monkeypatch):
    several = "\n".join(f"@ti.func\ndef f{n}(x):\n    return x\n\n" for n in range(20))
    (tmp_path / "some_kernels.py").write_text(f"import taichi as ti\n\n{several}", encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setitem(sys.modules, "one_of_many", Asked("one_of_many"))
    Asked.times = 0
    importlib.import_module("some_kernels")
    del sys.modules["some_kernels"]
    assert Asked.times < 5
