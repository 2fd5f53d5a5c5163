"""Random damage to a file: bytes, lines and cells are changed, dropped, doubled, swapped, and
replaced by numbers and words that break readers, or by pieces of another file of the same kind.
"""

import re
from collections.abc import Callable, Sequence

import numpy as np

WORDS = (
    *(b"nan", b"NaN", b"inf", b"-inf", b"1e309", b"-1", b"0", b"1e-320", b"99999999999999999999"),
    *(b"", b" ", b"\t", b",", b"\n", b"\r\n", b"\0", b"\xff\xfe", b"\xef\xbb\xbf", "é∞".encode()),
    *(b'"', b"'", b"[", b"{", b"<", b">", b"&x;", b"%s", b"--", b"1.2.3", b"0x10", b"1,5", b"True"),
    *(b"1e300", b"-1e300", b"1e-300", b"2147483648", b"-2147483649", b"65536", b"1_000", b"null"),
    *(b"[[", b"{}", b"[]", b"=", b"#", b"]]", b"]", b"}", b"true", b"1979-05-27", b"\xc2\xb2"),
    *(b"../../x", b"/dev/null", b"a" * 300, b"9" * 400, b"(" * 50, "\u0661".encode(), b"\x1a"),
    *(1200 * b"[", 1200 * b'{"a":', 1200 * b"<a>"),
)

NUMBERS = (0, 1, -1, 127, 128, 255, 256, 32767, 32768, 65535, 65536, 2**31 - 1, 2**31, 2**32 - 1)
"""written into binary files as whole numbers of 1, 2, 4 and 8 bytes"""


def damaged(data: bytes, rng: np.random.Generator, others: Sequence[bytes] = ()) -> bytes:
    """One random change, or up to four; ``others`` are of the same kind, to take pieces of."""
    for _ in range(min(4, rng.geometric(0.6))):
        if others and rng.random() < 0.1:
            data = _spliced(data, others[int(rng.integers(len(others)))], rng)
        else:
            data = CHANGES[rng.integers(len(CHANGES))](data, rng)
    return data


def _place(data: bytes, rng: np.random.Generator) -> tuple[int, int]:
    begin = int(rng.integers(len(data) + 1))
    return begin, min(len(data), begin + int(rng.geometric(0.15)))


def _flip(data: bytes, rng: np.random.Generator) -> bytes:
    if not data:
        return data
    changed = bytearray(data)
    changed[rng.integers(len(data))] ^= 1 << int(rng.integers(8))
    return bytes(changed)


def _replace(data: bytes, rng: np.random.Generator) -> bytes:
    begin, end = _place(data, rng)
    return data[:begin] + WORDS[rng.integers(len(WORDS))] + data[end:]


def _number(data: bytes, rng: np.random.Generator) -> bytes:
    """Writes a whole number over as many bytes as it has."""
    begin, size = int(rng.integers(len(data) + 1)), 1 << int(rng.integers(4))
    number = NUMBERS[rng.integers(len(NUMBERS))] % (1 << 8 * size)
    order = "little" if rng.random() < 0.7 else "big"
    return data[:begin] + number.to_bytes(size, order) + data[begin + size :]


def _drop(data: bytes, rng: np.random.Generator) -> bytes:
    begin, end = _place(data, rng)
    return data[:begin] + data[end:]


def _double(data: bytes, rng: np.random.Generator) -> bytes:
    begin, end = _place(data, rng)
    return data[:end] + data[begin:end] + data[end:]


def _truncate(data: bytes, rng: np.random.Generator) -> bytes:
    return data[: rng.integers(len(data) + 1)]


def _lines(data: bytes, rng: np.random.Generator) -> bytes:
    """Drops, doubles or swaps lines."""
    lines = data.split(b"\n")
    a, b = (int(k) for k in rng.integers(len(lines), size=2))
    kind = rng.integers(3)
    if kind == 0:
        del lines[a]
    elif kind == 1:
        lines.insert(b, lines[a])
    else:
        lines[a], lines[b] = lines[b], lines[a]
    return b"\n".join(lines)


_CELL = re.compile(rb"[^\s,;<>=\[\]\"]+")


def _cell(data: bytes, rng: np.random.Generator) -> bytes:
    """Replaces a cell of a line, between blanks, commas, quotes or brackets."""
    begin, end = _some_cell(data, rng)
    return data[:begin] + WORDS[rng.integers(len(WORDS))] + data[end:]


def _other_cell(data: bytes, rng: np.random.Generator) -> bytes:
    """Replaces a cell by another one of the file."""
    (begin, end), (a, b) = _some_cell(data, rng), _some_cell(data, rng)
    return data[:begin] + data[a:b] + data[end:]


def _some_cell(data: bytes, rng: np.random.Generator) -> tuple[int, int]:
    found = _CELL.search(data, int(rng.integers(len(data) + 1)))
    return found.span() if found else (len(data), len(data))


def _spliced(data: bytes, other: bytes, rng: np.random.Generator) -> bytes:
    """The beginning of one and the end of the other, or a line of the other within the one."""
    if rng.random() < 0.5:
        return data[: rng.integers(len(data) + 1)] + other[rng.integers(len(other) + 1) :]
    lines, foreign = data.split(b"\n"), other.split(b"\n")
    lines.insert(int(rng.integers(len(lines) + 1)), foreign[rng.integers(len(foreign))])
    return b"\n".join(lines)


CHANGES: tuple[Callable[[bytes, np.random.Generator], bytes], ...] = (
    *(_flip, _flip, _replace, _drop, _double, _truncate, _lines, _number, _number),
    *(_cell, _cell, _cell, _other_cell),
)
