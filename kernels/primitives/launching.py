"""Launches without Taichi's look at every argument, which takes longer than most of these kernels run.

A call of a `ti.kernel` inspects each array anew, some 25 us apiece. Once a kernel is compiled, `quick` checks
only what machine code relies on, and hands over addresses; on the CPU only those of arrays that aren't the
same objects as at the launch before, and shapes only where these differ. Small arrays that a kernel only
reads needn't be handed over at all, see `copying`.

Before its first launch, Taichi reads a kernel: it notes for every expression where it stands, which takes
half the time and serves its complaints alone, and looks for a function's source at every call of it.

All of this is private to Taichi 1.7, and `taichi_inside` alone knows of it. So it is tried on a small
kernel first, see `agrees`; should anything differ, all launches go Taichi's own way, and steps take twice as
long.
"""

import gc
import threading
import warnings
from collections.abc import Callable, Mapping, Sequence
from ctypes import addressof, c_char
from functools import wraps
from itertools import chain, compress
from operator import is_not
from typing import Any

import numpy as np
import taichi as ti

from gridslam.kernels.primitives.device import ON_CPU
from gridslam.kernels.primitives.launch_trial import attempts as _attempts
from gridslam.kernels.primitives.launch_trial import sample as _sample
from gridslam.kernels.primitives.packing import as_packs, flat_names, grouped, members_of
from gridslam.kernels.primitives.taichi_inside import (
    Arguments,
    compiled_and_program,
    inner,
    machine_code,
    numpy_type,
    read_quickly,
)
from gridslam.kernels.primitives.watching import WATCHERS, Launch

_one_at_a_time = threading.RLock()
_verdict: list[bool] = []
Place = tuple[int]
ndarray, NOTHING = np.ndarray, object()
MOST_LAUNCHES, KEYS = 16, ("only", "start", "whose", "anchor", "path", "radio")
"""Launches of a kernel that a thread keeps side by side; arguments that tell them apart, anchors mostly."""
GOOD = [True]
START_OF: Callable[[Any], Any] = (c_char * 0).from_buffer
"""Stands at an array's first number."""


def copying(*names: str) -> Callable[[Any], Any]:
    """As `quick`, of a kernel of which some arrays or blocks are small, new at most launches, and only read.

    They are copied into arrays that the launch has of its own, which takes a third of the time of handing
    them over. Nothing that the kernel writes into them is seen.
    """
    return lambda kernel: quick(kernel, names)


def quick(kernel: Any, copied: Sequence[str] = ()) -> Any:
    """A kernel, launched quickly if that `agrees` with Taichi's own launches.

    Whatever isn't as it was compiled for goes Taichi's own way.

    Parameters
    ----------
    kernel : ti.kernel
        Its arguments are arrays of given type and number of dimensions, blocks of such arrays (see
        `packing`), and numbers; it returns nothing.
    copied : sequence of str
        See `copying`.

    Notes
    -----
    A thread keeps the arguments of its last launches of each kernel, one for each of the last few anchors,
    and takes an array that it keeps for unchanged: nobody may give it another shape, type or size in place.
    """
    primal = inner(kernel)
    if primal is None:
        return kernel
    hurried, plain, name = _hurrying(kernel, copied), _plain(kernel), kernel.__name__

    @wraps(kernel)
    def launch(*arguments: Any) -> Any:
        chosen = hurried if _verdict == GOOD or agrees() else plain
        return WATCHERS[-1](name, chosen, arguments) if WATCHERS else chosen(*arguments)

    known: Any = launch
    known.names = flat_names(primal.arguments)
    known.named = lambda **flat: launch(*grouped(primal.arguments, flat))
    return known


def _plain(kernel: Any) -> Launch:
    """Taichi's own launch, with blocks handed over as tuples."""
    known = inner(kernel).arguments
    if not any(members_of(argument.annotation) for argument in known):
        return kernel

    def launch(*arguments: Any) -> Any:
        if len(arguments) != len(known):
            raise TypeError(f"missing or too many arguments: {len(arguments)} instead of {len(known)}")
        return kernel(*as_packs(known, arguments))

    return launch


def agrees() -> bool:
    """Whether quick launches do what Taichi's own do, here and now; tried once in a process.

    A kernel is read and launched both ways: with the same arguments again, with other ones, and in turns.
    """
    with _one_at_a_time:
        if not _verdict:
            attempts, hurried, trouble = _attempts(), [], ""
            try:
                hurried = _made(_hurrying(_sample()), attempts)
            except Exception as error:
                trouble = f"{type(error).__name__}: {error}"
            if _made(_plain(_sample()), attempts) != hurried:  # if this fails, so does any launch
                trouble = trouble or "results differ"
            _verdict.append(not trouble)
            if trouble:
                known = ".".join(map(str, ti.__version__))
                warning = f"Taichi {known} isn't launched quickly, and steps take twice as long: {trouble}"
                warnings.warn(warning, RuntimeWarning, stacklevel=3)
        return _verdict[0]


def _made(kernel: Launch, attempts: Sequence[tuple[Any, ...]]) -> list[bytes]:
    """What the sample kernel makes of them, as bytes: all of it, or there would be NaN."""
    found = []
    for arguments in attempts:
        out = np.full(arguments[2].shape, np.nan)
        kernel(*arguments, out)
        found.append(out.tobytes())
    return found


def _hurrying(kernel: Any, copied: Sequence[str] = ()) -> Launch:
    """A quick launch of a kernel, whether that agrees or not."""
    primal, plain = inner(kernel), _plain(kernel)
    known = primal.arguments
    packs = [n for n, argument in enumerate(known) if members_of(argument.annotation)]
    others = [n for n in range(len(known)) if n not in packs]
    members = [kind for n in packs for kind in members_of(known[n].annotation).values()]
    kinds = [_kind(known[n].annotation) for n in others] + [_kind(kind) for kind in members]
    # Taichi leaves a pack its place, and hands its arrays over behind all arguments
    places = [(n,) for n in others] + [(len(known) + n,) for n in range(len(members))]
    slots = list(zip(places, kinds, strict=True))
    numbers, alone, packed = range(len(slots)), [n in others for n in range(len(known))], bool(packs)
    blocks = [not single for single in alone]
    spare = {n: known[n].annotation for n in packs}
    own, key = _Launches(), _key(flat_names(known)) if ON_CPU else None
    copies = _places_of(copied, known) if ON_CPU else []

    def launch(*arguments: Any) -> Any:
        compiled, program = compiled_and_program(primal)
        if len(compiled) != 1 or len(arguments) != len(known):
            return plain(*arguments) if compiled else _first(plain, arguments)
        values = list(arguments)
        if packed:
            values = [*compress(arguments, alone), *chain.from_iterable(compress(arguments, blocks))]
        if len(values) != len(slots):
            return plain(*arguments)
        (code,) = compiled.values()
        reused = _reused_launch(own, code, program, values, key, spare)
        context, handed = reused.context, reused.handed
        if not ON_CPU:
            context, handed = reused.fresh(), [NOTHING] * len(handed)
        for number in copies:
            value, mine = values[number], handed[number]
            if type(value) is not ndarray:
                return plain(*arguments)
            if type(mine) is ndarray and value.shape == mine.shape and value.dtype is mine.dtype:
                mine[...] = value
                values[number] = mine
            else:
                values[number] = value.copy()
        for number in compress(numbers, map(is_not, values, handed)):
            if not _hand_over(context, handed, number, slots[number], values[number]):
                return plain(*arguments)
        return context.launch()

    return launch


class _Launches(threading.local):
    """What a thread keeps of a kernel, the one launched last at the end."""

    def __init__(self) -> None:
        self.launches: list[_ReusedLaunch] = []


def _places_of(names: Sequence[str], known: Sequence[Any]) -> list[int]:
    """Numbers of the arrays of these names, or in blocks of these names."""
    flat = flat_names(known)
    blocks = {argument.name: members_of(argument.annotation) for argument in known}
    return [flat.index(name) for one in names for name in blocks.get(one) or [one]]


def _key(names: list[str]) -> int | None:
    """Which value tells launches apart that are kept; None for one alone."""
    return next((names.index(name) for name in KEYS if name in names), None)


def _reused_launch(
    own: _Launches, code: Any, program: Any, values: Sequence[Any], key: int | None, spare: Mapping[int, Any]
) -> "_ReusedLaunch":
    """The launch that a thread keeps for such a key; else a new one, or the one not used for longest."""
    launches = own.launches
    if not launches or launches[-1].code is not code or launches[-1].program is not program:
        launches = own.launches = [_ReusedLaunch.first(code, program, spare, len(values))]
    latest = launches[-1]
    if key is None or latest.handed[key] is values[key]:
        return latest
    for one in reversed(launches):  # as many ago as there are anchors, which mostly are few
        if one.handed[key] is values[key]:
            launches.remove(one)
            break
    else:
        one = launches.pop(0) if len(launches) == MOST_LAUNCHES else latest.another()
    launches.append(one)
    return one


class _ReusedLaunch:
    """What one thread keeps of a kernel: machine code, a launch, and the arguments that this holds."""

    def __init__(self, code: Any, program: Any, machine: Any, empty: Mapping[int, Any], most: int) -> None:
        self.code, self.program, self.machine, self.empty = code, program, machine, empty
        self.context, self.handed = self.fresh(), [NOTHING] * most

    def fresh(self) -> Arguments:
        """A launch; packs hold nothing but arrays, which don't stand in them, so any will do."""
        context = Arguments(self.program, self.code, self.machine)
        for place, pack in self.empty.items():
            context.pack((place,), pack)
        return context

    @classmethod
    def first(cls, code: Any, program: Any, spare: Mapping[int, Any], most: int) -> "_ReusedLaunch":
        """The first of a kernel: its machine code, and packs that hold nothing."""
        empty = {place: kind(**dict.fromkeys(kind.members)) for place, kind in spare.items()}
        return cls(code, program, machine_code(program, code), empty, most)

    def another(self) -> "_ReusedLaunch":
        """Another one of the same kernel, to which nothing is handed over yet."""
        return _ReusedLaunch(self.code, self.program, self.machine, self.empty, len(self.handed))


def _first(kernel: Launch, arguments: Sequence[Any]) -> Any:
    """The first launch of all; should it fail, once more with places of expressions in the complaint.

    What Taichi makes of a kernel's source stays, so collecting garbage meanwhile finds none.
    """
    with _one_at_a_time:
        collects = gc.isenabled()
        gc.disable()
        try:
            with read_quickly():
                return kernel(*arguments)
        except (TypeError, ti.TaichiCompilationError):
            return kernel(*arguments)
        finally:
            if collects:
                gc.enable()


def _hand_over(
    context: Arguments, handed: list[Any], number: int, slot: tuple[Place, Any], value: Any
) -> bool:
    """Put one argument into a launch, at its place; whether it is of the right kind."""
    place, kind = slot
    before, handed[number] = handed[number], NOTHING  # if an interrupt comes between, all is handed over
    if type(value) is ndarray and type(kind) is tuple:
        dtype, axes, inner = kind
        own, shape = value.dtype, value.shape
        if (own is not dtype and own != dtype) or len(shape) != axes or (inner and shape[-1:] != inner):
            return False
        try:
            address = addressof(START_OF(value))
        except TypeError:  # not to be written to, or not in one piece
            if not value.flags.c_contiguous:
                return False
            address = value.ctypes.data
        # the shape takes longest to hand over, and mostly stands there
        known = type(before) is ndarray and before.shape == shape
        shape = () if known else shape[:-1] if inner else shape
        context.array(place, address, value.nbytes, shape, 0)
        handed[number] = value  # which keeps it where it is
    elif kind is float or kind is int:
        if type(value) is not kind:
            return False
        (context.real if kind is float else context.whole)(place, value)
        handed[number] = value
    elif isinstance(value, ti.Ndarray) and (numpy_type(value.dtype), len(value.shape), ()) == kind:
        context.device_array(place, value)
    else:
        return False
    return True


def _kind(annotation: Any) -> Any:
    """Type, dimensions and shape of the vectors in it, of an array; `int` or `float` for a number."""
    if isinstance(annotation, ti.types.ndarray):
        kind = annotation.dtype
        inner = (kind.n,) if hasattr(kind, "n") else ()
        return np.dtype(numpy_type(kind.dtype if inner else kind)), annotation.ndim + len(inner), inner
    return int if annotation in (ti.i32, ti.i64) else float
