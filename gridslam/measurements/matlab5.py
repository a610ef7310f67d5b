"""The arrays of MATLAB's version 5 to 7 files, every length checked before it is believed.

SciPy's reader crashes the interpreter on some damaged files (an array whose lengths lie is enough), which no
exception handler survives; so the little that a table needs of this format is read here: numbers, text,
cell arrays of text, one struct. Names of types and classes are those of MathWorks' "MAT-File Format".
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Collection, Iterator
from typing import Any

import numpy as np

NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
ENCODINGS = {1: "latin-1", 2: "latin-1", 4: "utf-16", 16: "utf-8", 17: "utf-16", 18: "utf-32"}
MATRIX, COMPRESSED = 14, 15
CELL, STRUCT, TEXT, DOUBLE, UINT64 = 1, 2, 4, 6, 15
COMPLEX, HEADER, DEEPEST = 0x0800, 128, 6


class Damaged(ValueError):
    """The bytes aren't what the format says."""


def read_arrays(content: bytes, wanted: Collection[str], largest: int) -> dict[str, Any]:
    """Read the variables of some names.

    Parameters
    ----------
    content : bytes
        The whole file.
    wanted : collection of str
    largest : int
        Bytes that the packed variables may have once they are unpacked.

    Returns
    -------
    dict
        Real or complex arrays; lists of rows of text, or of words of a cell array ("" for a cell that holds
        something else); dictionaries of a struct's fields; None for anything else.

    Raises
    ------
    Damaged
        No such file, cut short, or lengths that don't fit.
    """
    if len(content) < HEADER or content[126:128] not in (b"IM", b"MI"):
        raise Damaged("no MATLAB header")
    order = "<" if content[126:128] == b"IM" else ">"
    found: dict[str, Any] = {}
    left = largest
    for kind, data in _elements(content[HEADER:], order, packed=True):
        if kind == COMPRESSED:
            data = _unpacked(data, left)
            left -= len(data)
            kind, data = next(_elements(data, order), (0, b""))
        if kind == MATRIX:
            name, value = _matrix(data, order, wanted, 0)
            if name in wanted:
                found[name] = value
    return found


def _elements(data: bytes, order: str, packed: bool = False) -> Iterator[tuple[int, bytes]]:
    """Types and contents, one after the other; `packed` for those of a file, padded only if they aren't."""
    place = 0
    while place + 8 <= len(data):
        kind, size = struct.unpack_from(f"{order}II", data, place)
        if kind >> 16:  # up to four bytes lie in the tag itself
            begin, size, kind, step = place + 4, kind >> 16, kind & 0xFFFF, 8
            if size > 4:
                raise Damaged("a small element of more than four bytes")
        else:
            begin = place + 8
            step = 8 + size + (0 if packed and kind == COMPRESSED else -size % 8)
        if begin + size > len(data):
            raise Damaged("a variable that is cut short")
        yield kind, data[begin : begin + size]
        place += step
    if packed and place < len(data):
        raise Damaged("a variable that is cut short")


def _unpacked(data: bytes, most: int) -> bytes:
    engine = zlib.decompressobj()
    try:
        whole = engine.decompress(data, most + 1)
    except zlib.error as error:
        raise Damaged(str(error)) from error
    if len(whole) > most:
        raise Damaged("a file too large once it is unpacked")
    if not engine.eof:
        raise Damaged("a variable that is cut short")
    return whole


def _matrix(data: bytes, order: str, wanted: Collection[str] | None, depth: int) -> tuple[str, Any]:
    """Name and value of an array; of the outermost ones only those wanted are read."""
    if not data:
        return "", np.zeros(0)
    parts = _elements(data, order)
    flags, size, name = _next(parts), _next(parts), _next(parts)[1].decode("latin-1")
    if wanted is not None and name not in wanted:
        return name, None
    if len(flags[1]) < 4 or size[0] != 5 or len(size[1]) % 4 or not size[1] or depth > DEEPEST:
        raise Damaged("an array without its size")
    flag = struct.unpack_from(f"{order}I", flags[1])[0]
    shape = struct.unpack(f"{order}{len(size[1]) // 4}i", size[1])
    count = math.prod(shape)
    shape = shape if count else (0,)  # an empty array may be as wide as it likes
    if min(shape) < 0 or count > len(data) or len(shape) > 32:
        raise Damaged(f"an array of {count} elements in {len(data)} bytes")
    kind = flag & 0xFF
    if kind == CELL:
        return name, [_word(_inner(parts, order, depth)) for _ in range(count)]
    if kind == STRUCT:
        return name, _fields(parts, order, depth) if count == 1 else None
    if kind == TEXT:
        return name, _text(parts, order, shape) if count else []
    if not DOUBLE <= kind <= UINT64:
        return name, None
    values = _numbers(parts, order, count).reshape(shape, order="F")
    return name, values + 1j * _numbers(parts, order, count).reshape(
        shape, order="F"
    ) if flag & COMPLEX else values


def _next(parts: Iterator[tuple[int, bytes]]) -> tuple[int, bytes]:
    try:
        return next(parts)
    except StopIteration:
        raise Damaged("an array that is cut short") from None


def _inner(parts: Iterator[tuple[int, bytes]], order: str, depth: int) -> Any:
    kind, data = _next(parts)
    if kind != MATRIX:
        raise Damaged("a cell or field that is no array")
    return _matrix(data, order, None, depth + 1)[1]


def _fields(parts: Iterator[tuple[int, bytes]], order: str, depth: int) -> dict[str, Any]:
    width, names = _next(parts)[1], _next(parts)[1]
    length = struct.unpack_from(f"{order}i", width)[0] if len(width) >= 4 else 0
    if length < 1 or len(names) % length:
        raise Damaged("a struct without names of its fields")
    words = [names[k : k + length].split(b"\0")[0].decode("latin-1") for k in range(0, len(names), length)]
    return {word: _inner(parts, order, depth) for word in words}


def _numbers(parts: Iterator[tuple[int, bytes]], order: str, count: int) -> np.ndarray:
    """Numbers in whatever type they are stored; MATLAB stores small ones in a smaller one."""
    kind, data = _next(parts) if count else (9, b"")
    if kind not in NUMBERS:
        raise Damaged(f"numbers of the unknown type {kind}")
    dtype = np.dtype(f"{order}{NUMBERS[kind]}")
    if len(data) != count * dtype.itemsize:
        raise Damaged(f"an array of {count} elements in {len(data)} bytes")
    return np.frombuffer(data, dtype).astype(dtype.newbyteorder("="))


def _text(parts: Iterator[tuple[int, bytes]], order: str, shape: tuple[int, ...]) -> list[str]:
    """Rows of characters, without the blanks that fill them up."""
    kind, data = _next(parts)
    if kind not in ENCODINGS:
        raise Damaged(f"text of the unknown type {kind}")
    suffix = {"utf-16": "-le", "utf-32": "-le"} if order == "<" else {"utf-16": "-be", "utf-32": "-be"}
    encoding = ENCODINGS[kind] + suffix.get(ENCODINGS[kind], "")
    text = data.decode(encoding, "replace")
    if len(shape) != 2 or (len(text) != math.prod(shape) and shape[0] != 1):
        raise Damaged("text of another size")
    return ["".join(text[k :: shape[0]]).rstrip() for k in range(shape[0])]


def _word(value: Any) -> str:
    return value[0] if isinstance(value, list) and len(value) == 1 and isinstance(value[0], str) else ""
