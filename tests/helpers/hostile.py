"""Damaged and absurd files, made of good ones."""

import os
import re
import resource

from hypothesis import HealthCheck, settings
from hypothesis import strategies as st

from gridslam.errors import InputError

CASES = settings(
    max_examples=int(os.environ.get("GRIDSLAM_HOSTILE_CASES", "250")),
    deadline=None,
    database=None,
    derandomize="GRIDSLAM_HOSTILE_CASES" not in os.environ,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
FEWER = settings(CASES, max_examples=CASES.max_examples // 5)
FEWEST = settings(CASES, max_examples=CASES.max_examples // 20)
"""Where each case starts a process."""
LARGEST_KB = 800_000
NASTY = (
    *("", "0", "-1", "1", "nan", "-inf", "1e308", "-1e308", "1e-320", "1e400", "9" * 30, "9" * 5000, "0x1p9"),
    *(
        "1_0",
        "true",
        "null",
        "[]",
        "{}",
        '""',
        '"x"',
        "'",
        '"',
        "\x00",
        "\ufeff",
        "\u202e",
        "é",
        "\u0661",
        "\n",
        "#",
    ),
    *("[[", "]]", "=", ",", "1000000000000", "-0.0", "00", "1:2", "2020-01-01", "{" * 300, "[" * 3000),
    *("__import__('os').getcwd()", "${x}", "../../x", "LWPOLYLINE", "INSERT", "anchors", "features"),
)
TOKEN = re.compile(r"-?\d+\.?\d*(?:e-?\d+)?|\w+|\"[^\"\n]*\"|[^\s\w]|\n")


def damaged(content: bytes):
    """Bytes cut short, flipped, doubled, left out or overwritten, in a few places."""
    place = st.floats(0, 1, exclude_max=True)
    change = st.tuples(
        st.sampled_from(("flip", "cut", "drop", "double", "write")),
        place,
        st.integers(1, 40),
        st.binary(max_size=8),
    )

    def spoil(changes):
        data = bytearray(content)
        for kind, where, length, new in changes:
            at = int(where * len(data))
            if kind == "flip" and data:
                data[at] ^= 1 << (length % 8)
            elif kind == "cut":
                del data[at:]
            elif kind == "drop":
                del data[at : at + length]
            elif kind == "double":
                data[at:at] = data[at : at + length]
            else:
                data[at : at + len(new)] = new
        return bytes(data)

    return st.lists(change, min_size=1, max_size=4).map(spoil)


def retold(text: str):
    """Text some of whose words and numbers are replaced by nasty ones."""
    spans = [match.span() for match in TOKEN.finditer(text)]
    swap = st.tuples(st.integers(0, len(spans) - 1), st.sampled_from(NASTY) | st.text(max_size=5))

    def spoil(swaps):
        result = text
        for number, word in sorted(dict(swaps).items(), reverse=True):
            start, end = spans[number]
            result = result[:start] + word + result[end:]
        return result.encode("utf-8", "surrogatepass")

    return st.lists(swap, min_size=1, max_size=5).map(spoil)


def harmless(read, path, content=None):
    """Read a file: it may be refused in one line, and nothing else may happen."""
    if content is not None:
        path.write_bytes(content)
    refused, before = "", resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    try:
        read(path)
    except InputError as error:
        refused = str(error)
    assert refused.isprintable()
    assert len(refused) < 2000
    # the peak that other tests of this process have reached before isn't this file's
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss < LARGEST_KB + before
