"""Where everything lies in a PLY file: its header, and the place of every value of every element.

One scheme serves both encodings: a body is an array of *units*, bytes in a binary file and numbers in an ASCII one, and
a `Column` says at which units the values of one property begin.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from ..core.errors import InputError
from .text import decoded

_TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"},
    **{"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4"},
    **{"float": "f4", "double": "f8", "float32": "f4", "float64": "f8"},
}
_BYTE_ORDERS = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}


@dataclass(frozen=True)
class Property:
    """One property of an element; `count` is the type of a list's length, None for a single value."""

    name: str
    dtype: np.dtype
    count: np.dtype | None


@dataclass(frozen=True)
class Element:
    """A table of the file: its name, its number of rows and its properties in order."""

    name: str
    length: int
    properties: tuple[Property, ...]


@dataclass(frozen=True)
class Header:
    """What a PLY file says of itself before its body."""

    ascii: bool
    elements: tuple[Element, ...]
    comments: tuple[str, ...]
    size: int
    """Bytes up to the body."""


@dataclass(frozen=True, eq=False)
class Column:
    """Where the values of one property begin, in units; for a list, its first value and how many there are."""

    starts: Int[np.ndarray, " N"]
    dtype: np.dtype
    counts: Int[np.ndarray, " N"] | None = None


def read_header(data: bytes, path: Path) -> Header:
    """Parse the header of a PLY file.

    Raises:
        InputError: not a PLY file, or a header that is cut short or says what PLY does not know.
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
    comments = tuple(text.strip().removeprefix("comment").strip() for text in texts if text.split()[:1] == ["comment"])
    # Where lines end in a bare CR, an LF behind the last one is the first byte of the body.
    is_pair = end[1] == b"\n" and data[end.end() :][:2] == b"\r\n"
    return Header(order == "=", elements, comments, end.end() + (2 if is_pair else 1))


def read_units(data: bytes, header: Header, path: Path) -> np.ndarray:
    """The body as units: bytes, or the numbers of an ASCII file."""
    if not header.ascii:
        return np.frombuffer(data, np.uint8, offset=min(header.size, len(data)))
    words = data[header.size :].split()
    try:
        return np.array(list(map(float, words)), np.float64)
    except ValueError as error:
        raise InputError(f"{path}: expected numbers after the header, found {error!r:.80}; export it again") from error


def locate(header: Header, units: np.ndarray, path: Path) -> dict[str, dict[str, Column]]:
    """Find every property of every element: `columns[element][property]`.

    Raises:
        InputError: the body is shorter than the header says.
    """
    columns: dict[str, dict[str, Column]] = {}
    start = 0
    for element in header.elements:
        least = start + element.length * sum(_least_size(p, header.ascii) for p in element.properties)
        located = None
        if least <= len(units):
            located = _locate_uniform(element, units, start) or _locate_rows(element, units, start)
        if located is None:
            raise InputError(
                f"{path}: expected {element.length} rows of element '{element.name}', found the file cut short; "
                "export it again"
            )
        columns[element.name], start = located
    return columns


def gather(units: np.ndarray, column: Column) -> np.ndarray:
    """The values of a column, lists one after another."""
    starts = column.starts
    if column.counts is not None:
        within = np.arange(column.counts.sum()) - np.repeat(np.cumsum(column.counts) - column.counts, column.counts)
        starts = np.repeat(starts, column.counts) + within * _size(column.dtype, units)
    if units.dtype != np.uint8:
        return units[starts]
    return units[_bytes_of(starts, column.dtype)].view(column.dtype)[:, 0]


def scatter(units: np.ndarray, column: Column, rows: Int[np.ndarray, " M"], values: Float[np.ndarray, " M"]) -> None:
    """Write values of a binary body, in place, in the column's own type."""
    chosen = _bytes_of(column.starts[rows], column.dtype)
    units[chosen] = values.astype(column.dtype)[:, None].view(np.uint8)


def _read_elements(lines: list[list[str]], order: str) -> tuple[Element, ...]:
    elements: list[Element] = []
    for words in lines:
        if words[:1] == ["element"]:
            if int(words[2]) < 0:
                raise ValueError(f"an element of {words[2]} rows")
            elements.append(Element(words[1], int(words[2]), ()))
        elif words[:1] == ["property"]:
            last = elements.pop()
            elements.append(Element(last.name, last.length, (*last.properties, _read_property(words, order))))
    return tuple(elements)


def _read_property(words: list[str], order: str) -> Property:
    if words[1] == "list":
        return Property(words[4], np.dtype(order + _TYPES[words[3]]), np.dtype(order + _TYPES[words[2]]))
    return Property(words[2], np.dtype(order + _TYPES[words[1]]), None)


def _locate_uniform(element: Element, units: np.ndarray, start: int) -> tuple[dict[str, Column], int] | None:
    """Columns of an element whose lists are as long in every row as in the first; None if they are not."""
    if element.length == 0 or not element.properties:
        none = np.zeros(0, int)
        return {p.name: Column(none, p.dtype, None if p.count is None else none) for p in element.properties}, start
    first = _locate_rows(Element(element.name, 1, element.properties), units, start)
    if first is None:
        return None
    columns, end = first
    stride = end - start
    if start + stride * element.length > len(units):
        return None
    steps = stride * np.arange(element.length)
    moved: dict[str, Column] = {}
    for p in element.properties:
        one = columns[p.name]
        counts = None
        if p.count is not None and one.counts is not None:
            counts = np.full(element.length, one.counts[0])
            at = one.starts[0] - _size(p.count, units) + steps
            if (gather(units, Column(at, p.count)) != counts).any():
                return None
        moved[p.name] = Column(one.starts[0] + steps, p.dtype, counts)
    return moved, start + stride * element.length


def _locate_rows(element: Element, units: np.ndarray, start: int) -> tuple[dict[str, Column], int] | None:
    """Columns of an element, walking row by row over its lists; None if the body ends before."""
    numbers = units.tolist() if units.dtype != np.uint8 else None
    raw = units.tobytes() if numbers is None else b""
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
                if numbers is None:
                    order = "big" if p.count.str[0] == ">" else "little"
                    count = int.from_bytes(raw[position : position + width], order)
                elif 0 <= numbers[position] <= len(numbers):
                    count = int(numbers[position])
                else:
                    return None
                counts[k, row] = count
                position += width
            starts[k, row] = position
            position += count * _size(p.dtype, units)
    if position > len(units):
        return None
    columns = {
        p.name: Column(starts[k], p.dtype, counts[k] if p.count is not None else None)
        for k, p in enumerate(element.properties)
    }
    return columns, position


def _least_size(p: Property, is_ascii: bool) -> int:
    return 1 if is_ascii else (p.dtype if p.count is None else p.count).itemsize


def _size(dtype: np.dtype, units: np.ndarray) -> int:
    return dtype.itemsize if units.dtype == np.uint8 else 1


def _bytes_of(starts: Int[np.ndarray, " N"], dtype: np.dtype) -> Int[np.ndarray, "N S"]:
    return starts[:, None] + np.arange(dtype.itemsize)
