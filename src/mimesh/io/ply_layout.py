"""Parse the header of a PLY file and locate the values of every property of every element in its body.

One scheme serves both encodings: the body is an array of *units*, bytes in a binary file and numbers in an ASCII file,
and a `PlyColumn` holds the unit index at which each value of one property begins.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Int

from ..core.budgets import ELEMENTS
from ..core.errors import InputError
from .text import decoded

_TYPES = {  # type names of the original specification and of later writers -> NumPy types
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"},
    **{"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4"},
    **{"float": "f4", "double": "f8", "float32": "f4", "float64": "f8"},
}
_BYTE_ORDERS = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}


@dataclass(frozen=True)
class PlyProperty:
    """One property of an element: a single value or a list."""

    name: str
    dtype: np.dtype
    """Type of the value, or of the items of a list."""
    count: np.dtype | None
    """Type of the length of a list; None for a single value."""


@dataclass(frozen=True)
class PlyElement:
    """One table of the file, such as `vertex` or `face`."""

    name: str
    length: int
    """Number of rows."""
    properties: tuple[PlyProperty, ...]
    """Columns in file order."""


@dataclass(frozen=True)
class PlyHeader:
    """The parsed header of a PLY file."""

    ascii: bool
    elements: tuple[PlyElement, ...]
    comments: tuple[str, ...]
    size: int
    """Bytes from the start of the file to the body."""


@dataclass(frozen=True, eq=False)
class PlyColumn:
    """The location of the values of one property in the body."""

    starts: Int[np.ndarray, " N"]
    """Unit index of the value of each row; of a list, of its first item."""
    dtype: np.dtype
    counts: Int[np.ndarray, " N"] | None = None
    """Items of the list of each row; None for single values."""


def read_header(data: bytes, path: Path) -> PlyHeader:
    """Parse the header of a PLY file.

    Raises:
        InputError: the file is no PLY file, or its header is truncated or has an unknown format or type.
    """
    end = re.search(rb"([\r\n])end_header[ \t]*", data)
    if not data.startswith(b"ply") or end is None:
        raise InputError(
            f"{path}: expected a PLY header from 'ply' to 'end_header', found none; export it again as PLY"
        )
    texts = [decoded(line) for line in data[: end.start()].splitlines()]
    lines = [text.split() for text in texts]
    try:
        encoding = next(words[1] for words in lines if words[:1] == ["format"])
        order = _BYTE_ORDERS[encoding]
        elements = _read_elements(lines, order)
    except (StopIteration, LookupError, ValueError) as error:
        raise InputError(
            f"{path}: expected a PLY header with a known format, elements and property types, "
            f"found {str(error) or 'no format'}; export it again as binary PLY"
        ) from error
    ELEMENTS.check(sum(1 + len(element.properties) for element in elements), path)
    comments = tuple(text.strip().removeprefix("comment").strip() for text in texts if text.split()[:1] == ["comment"])
    # The header ends with one line end, which is CR LF only where the other lines end so too: after a bare CR, an LF is
    # the first byte of the body.
    is_pair = end[1] == b"\n" and data[end.end() :][:2] == b"\r\n"
    return PlyHeader(order == "=", elements, comments, end.end() + (2 if is_pair else 1))


def read_units(data: bytes, header: PlyHeader, path: Path) -> np.ndarray:
    """Return the body as units: bytes, or the numbers of an ASCII file; raises InputError for other words in it."""
    if not header.ascii:
        return np.frombuffer(data, np.uint8, offset=min(header.size, len(data)))
    words = data[header.size :].split()
    try:
        return np.array(list(map(float, words)), np.float64)
    except ValueError as error:
        raise InputError(f"{path}: expected numbers after the header, found {error!r:.80}; export it again") from error


def locate_columns(header: PlyHeader, units: np.ndarray, path: Path) -> dict[str, dict[str, PlyColumn]]:
    """Locate every property of every element: `columns[element][property]`.

    Raises:
        InputError: the body is shorter than the header declares.
    """
    columns: dict[str, dict[str, PlyColumn]] = {}
    start = 0
    for element in header.elements:
        # Tested before anything is allocated: the header of a damaged file may declare any number of rows.
        min_end = start + element.length * sum(_min_size(p, header.ascii) for p in element.properties)
        located = None
        if min_end <= len(units):
            located = _locate_uniform(element, units, start) or _locate_rows(element, units, start)
        if located is None:
            raise InputError(
                f"{path}: expected {element.length} rows of element '{element.name}', found the file cut short; "
                "export it again"
            )
        columns[element.name], start = located
    return columns


def gather(units: np.ndarray, column: PlyColumn) -> np.ndarray:
    """Return the values of a column; those of lists are concatenated."""
    starts = column.starts
    if column.counts is not None:
        # Unit index of each list item: start of its list plus its position in the list times the item's size.
        within = np.arange(column.counts.sum()) - np.repeat(np.cumsum(column.counts) - column.counts, column.counts)
        starts = np.repeat(starts, column.counts) + within * _size(column.dtype, units)
    if units.dtype != np.uint8:
        return units[starts]
    return units[_bytes_of(starts, column.dtype)].view(column.dtype)[:, 0]


def _read_elements(lines: list[list[str]], order: str) -> tuple[PlyElement, ...]:
    """Parse the `element` and `property` lines of a header; `order` is the byte order as NumPy writes it."""
    elements: list[PlyElement] = []
    for words in lines:
        if words[:1] == ["element"]:
            if int(words[2]) < 0:
                raise ValueError(f"an element of {words[2]} rows")
            elements.append(PlyElement(words[1], int(words[2]), ()))
        elif words[:1] == ["property"]:
            last = elements.pop()
            elements.append(PlyElement(last.name, last.length, (*last.properties, _read_property(words, order))))
    return tuple(elements)


def _read_property(words: list[str], order: str) -> PlyProperty:
    if words[1] == "list":
        return PlyProperty(words[4], np.dtype(order + _TYPES[words[3]]), np.dtype(order + _TYPES[words[2]]))
    return PlyProperty(words[2], np.dtype(order + _TYPES[words[1]]), None)


def _locate_uniform(element: PlyElement, units: np.ndarray, start: int) -> tuple[dict[str, PlyColumn], int] | None:
    """Locate the columns of an element whose lists have the same length in every row; None where they do not.

    Rows then have one stride, so all columns follow from the first row without a Python loop. Returns the columns and
    the unit index after the element.
    """
    if element.length == 0 or not element.properties:
        empty = np.zeros(0, int)
        return {
            p.name: PlyColumn(empty, p.dtype, None if p.count is None else empty) for p in element.properties
        }, start
    first = _locate_rows(PlyElement(element.name, 1, element.properties), units, start)
    if first is None:
        return None
    columns, end = first
    stride = end - start
    if start + stride * element.length > len(units):
        return None
    steps = stride * np.arange(element.length)
    strided: dict[str, PlyColumn] = {}
    for p in element.properties:
        column = columns[p.name]
        counts = None
        if p.count is not None and column.counts is not None:
            counts = np.full(element.length, column.counts[0])
            count_starts = column.starts[0] - _size(p.count, units) + steps
            if (gather(units, PlyColumn(count_starts, p.count)) != counts).any():
                return None
        strided[p.name] = PlyColumn(column.starts[0] + steps, p.dtype, counts)
    return strided, start + stride * element.length


def _locate_rows(element: PlyElement, units: np.ndarray, start: int) -> tuple[dict[str, PlyColumn], int] | None:
    """Locate the columns of an element row by row, for lists of any length; None where the body ends too early.

    Returns the columns and the unit index after the element.
    """
    raw = units.data if units.dtype == np.uint8 else None  # no copy: there may be many elements
    starts = np.zeros((len(element.properties), element.length), np.int64)
    counts = np.zeros_like(starts)
    position = start
    for row in range(element.length):
        for k, p in enumerate(element.properties):
            count = 1
            if p.count is not None:
                width = _size(p.count, units)
                if position + width > len(units):
                    return None
                # The length is read from bytes or from a number; a negative or absurd one means damage.
                if raw is not None:
                    order = "big" if p.count.str[0] == ">" else "little"
                    count = int.from_bytes(raw[position : position + width], order)
                elif 0 <= units[position] <= len(units):
                    count = int(units[position])
                else:
                    return None
                counts[k, row] = count
                position += width
            starts[k, row] = position
            position += count * _size(p.dtype, units)
        if position > len(units):
            return None
    columns = {
        p.name: PlyColumn(starts[k], p.dtype, counts[k] if p.count is not None else None)
        for k, p in enumerate(element.properties)
    }
    return columns, position


def _min_size(p: PlyProperty, is_ascii: bool) -> int:
    """Return the fewest units that a property takes in a row: those of its value, or of an empty list."""
    return 1 if is_ascii else (p.dtype if p.count is None else p.count).itemsize


def _size(dtype: np.dtype, units: np.ndarray) -> int:
    """Return the units of one value: its bytes in a binary body, 1 in an ASCII body."""
    return dtype.itemsize if units.dtype == np.uint8 else 1


def _bytes_of(starts: Int[np.ndarray, " N"], dtype: np.dtype) -> Int[np.ndarray, "N S"]:
    """Return the index of every byte of values that begin at `starts`."""
    return starts[:, None] + np.arange(dtype.itemsize)
