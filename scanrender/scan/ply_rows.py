"""The rows of a PLY: elements of the body as columns, from text or bytes.

Nothing is read or allocated that the file is not long enough for.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt

from scanrender.errors import ScanError
from scanrender.scan.words import floats

Array = npt.NDArray[Any]
# A list column: how many values each row has, and all values end to end.
ListColumn = tuple[Array, Array]


@dataclass
class Property:
    name: str  # in lower case
    dtype: str
    count_dtype: str | None = None  # set for lists


@dataclass
class Element:
    name: str
    count: int
    properties: list[Property] = field(default_factory=list)


def truncated(path: Path, element: Element) -> ScanError:
    return ScanError(
        f"{path.name} ends before its {element.count} {element.name} elements do",
        str(path),
        "the file was cut short: copy or export it again",
    )


class BinaryRows:
    def __init__(self, stream: BinaryIO, path: Path, order: str) -> None:
        self.stream, self.path, self.order = stream, path, order
        self.size = path.stat().st_size

    def _holds(self, size: int) -> bool:
        return size <= self.size - self.stream.tell()

    def element(self, element: Element) -> dict[str, Any]:
        lists = [p for p in element.properties if p.count_dtype]
        smallest = sum(np.dtype(p.count_dtype or p.dtype).itemsize for p in element.properties)
        if not element.properties:
            return {}
        if not self._holds(smallest * element.count):
            raise truncated(self.path, element)
        if not lists:
            dtype = np.dtype([(p.name, self.order + p.dtype) for p in element.properties])
            return self._plain(element, dtype)
        return self._uniform(element) or self._general(element)

    def _plain(self, element: Element, dtype: np.dtype[Any]) -> dict[str, Any]:
        data = self.stream.read(dtype.itemsize * element.count)
        table = np.frombuffer(data, dtype, element.count)
        return {p.name: table[p.name] for p in element.properties}

    def _uniform(self, element: Element) -> dict[str, Any] | None:
        """The usual case: each list has the same length in every row, so rows have one layout."""
        start = self.stream.tell()
        first = self._row(element)
        fields: list[Any] = []
        for p, value in zip(element.properties, first or [], strict=False):
            if p.count_dtype:
                fields.append((p.name + "#", self.order + p.count_dtype))
                fields.append((p.name, self.order + p.dtype, (len(value),)))
            else:
                fields.append((p.name, self.order + p.dtype))
        self.stream.seek(start)
        if not fields:
            return {p.name: _no_rows(p) for p in element.properties} if not element.count else None
        dtype = np.dtype(fields)
        if self._holds(dtype.itemsize * element.count):
            data = self.stream.read(dtype.itemsize * element.count)
            table = np.frombuffer(data, dtype, element.count)
            lengths = {p.name: dtype[p.name].shape[0] for p in element.properties if p.count_dtype}
            if all((table[name + "#"] == length).all() for name, length in lengths.items()):
                return {
                    p.name: (
                        (np.full(element.count, lengths[p.name]), table[p.name].reshape(-1))
                        if p.count_dtype
                        else table[p.name]
                    )
                    for p in element.properties
                }
        self.stream.seek(start)
        return None

    def _general(self, element: Element) -> dict[str, Any]:
        rows = []
        for _ in range(element.count):
            row = self._row(element)
            if row is None:
                raise truncated(self.path, element)
            rows.append(row)
        return _columns(element, rows)

    def _row(self, element: Element) -> list[Any] | None:
        row: list[Any] = []
        for p in element.properties:
            count = 1
            if p.count_dtype:
                head = self._values(p.count_dtype, 1)
                if head is None:
                    return None
                count = int(head[0])
            values = self._values(p.dtype, count)
            if values is None:
                return None
            row.append(values if p.count_dtype else values[0])
        return row

    def _values(self, dtype: str, count: int) -> Array | None:
        kind = np.dtype(self.order + dtype)
        if count < 0 or not self._holds(kind.itemsize * count):
            return None
        return np.frombuffer(self.stream.read(kind.itemsize * count), kind)


class AsciiRows:
    def __init__(self, stream: BinaryIO, path: Path) -> None:
        self.lines = [line for line in stream.read().splitlines() if line.strip()]
        self.path, self.next = path, 0

    def element(self, element: Element) -> dict[str, Any]:
        lines = self.lines[self.next : self.next + element.count]
        if len(lines) < element.count:
            raise truncated(self.path, element)
        self.next += element.count
        width = len(element.properties)
        if not width:
            return {}
        if not any(p.count_dtype for p in element.properties):
            flat = floats(b" ".join(lines).split())
            if len(flat) != width * element.count:
                raise truncated(self.path, element)
            table = flat.reshape(element.count, width)
            return {p.name: table[:, i] for i, p in enumerate(element.properties)}
        return self._alike(element, lines) or _columns(
            element, [self._row(element, x) for x in lines]
        )

    def _alike(self, element: Element, lines: list[bytes]) -> dict[str, Any] | None:
        """The usual case: each list has the same length in every row."""
        if not lines:
            return None
        first_row = zip(element.properties, self._row(element, lines[0]), strict=True)
        lengths = [len(value) if p.count_dtype else 0 for p, value in first_row]
        width = sum(length + 1 for length in lengths)
        words = b" ".join(lines).split()
        if len(words) != width * len(lines):
            return None
        table = floats(words).reshape(len(lines), width)
        columns: dict[str, Any] = {}
        position = 0
        for p, length in zip(element.properties, lengths, strict=True):
            first = table[:, position]
            if p.count_dtype:
                if (first != length).any():
                    return None
                values = table[:, position + 1 : position + 1 + length].reshape(-1)
                columns[p.name] = (np.full(len(lines), length), values)
            else:
                columns[p.name] = first
            position += length + 1
        return columns

    def _row(self, element: Element, line: bytes) -> list[Any]:
        words, position = line.split(), 0
        row: list[Any] = []
        for p in element.properties:
            if position >= len(words):
                raise truncated(self.path, element)
            if p.count_dtype:
                count = int(words[position])
                values = words[position + 1 : position + 1 + count]
                if count < 0 or len(values) != count:
                    raise truncated(self.path, element)
                row.append(floats(values))
                position += 1 + count
            else:
                row.append(float(words[position]))
                position += 1
        return row


def _no_rows(p: Property) -> Any:
    return (np.zeros(0, np.int64), np.zeros(0)) if p.count_dtype else np.zeros(0)


def _columns(element: Element, rows: list[list[Any]]) -> dict[str, Any]:
    if not rows:
        return {p.name: _no_rows(p) for p in element.properties}
    columns: dict[str, Any] = {}
    for i, p in enumerate(element.properties):
        column = [row[i] for row in rows]
        if p.count_dtype:
            columns[p.name] = (np.array([len(x) for x in column]), np.concatenate(column))
        else:
            columns[p.name] = np.array(column)
    return columns
