"""What the pages of a Parquet file declare, before they are unpacked: pyarrow makes room for as much as each says.

A header of a page is a struct of Thrift's compact protocol, whose field 2 is the length of the page and field 3 that of
what is stored of it: https://parquet.apache.org/docs/file-format/data-pages/.
"""

import mmap
from pathlib import Path

import pyarrow.parquet as pq

_UNPACKED, _STORED = 2, 3
_STOP, _TRUE, _FALSE, _BYTE, _I16, _I32, _I64, _DOUBLE, _BINARY, _STRUCT = 0, 1, 2, 3, 4, 5, 6, 7, 8, 12
_DEEPEST = 3  # page header, header of its kind, statistics
_Content = mmap.mmap | bytes


def check_pages(path: Path, about: pq.FileMetaData) -> None:
    """Refuse, by a ValueError, a file with pages that are longer than its footer says, or that cannot be followed."""
    if not about.num_rows:
        return
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        for group in range(about.num_row_groups):
            for number in range(about.num_columns):
                _check_column(content, about.row_group(group).column(number))


def _check_column(content: _Content, column: pq.ColumnChunkMetaData) -> None:
    first = column.dictionary_page_offset
    at = min(first, column.data_page_offset) if first else column.data_page_offset
    end, unpacked = at + column.total_compressed_size, 0
    while at < end:
        try:
            page, at = _struct(content, at, 0)
        except IndexError as error:
            raise ValueError(f"{column.path_in_schema}: a page begins at the end of the file") from error
        if min(page.get(_UNPACKED, -1), page.get(_STORED, -1)) < 0:
            raise ValueError(f"{column.path_in_schema}: a page does not tell its length")
        unpacked, at = unpacked + page[_UNPACKED], at + page[_STORED]
    if unpacked > column.total_uncompressed_size:
        told = f"its footer says {column.total_uncompressed_size:,}"
        raise ValueError(f"{column.path_in_schema}: its pages unpack to {unpacked:,} bytes; {told}")


def _struct(content: _Content, at: int, depth: int) -> tuple[dict[int, int], int]:
    """The numbers of 32 bits of a struct by their fields, and where it ends."""
    if depth == _DEEPEST:
        raise ValueError("a header of a page goes too deep")
    numbers: dict[int, int] = {}
    field = 0
    while (head := content[at]) & 15 != _STOP:
        kind, at = head & 15, at + 1
        step = head >> 4
        if step:
            field += step
        else:
            field, at = _number(content, at)
        if kind in (_I16, _I32, _I64):
            value, at = _number(content, at)
            if kind == _I32:
                numbers[field] = value
        elif kind == _STRUCT:
            _, at = _struct(content, at, depth + 1)
        elif kind == _BINARY:
            length, at = _varint(content, at)
            at += length
        elif kind in (_TRUE, _FALSE, _BYTE, _DOUBLE):
            at += {_BYTE: 1, _DOUBLE: 8}.get(kind, 0)
        else:
            raise ValueError(f"a header of a page has a field of kind {kind}")
    return numbers, at + 1


def _number(content: _Content, at: int) -> tuple[int, int]:
    """A number whose sign is its last bit."""
    value, at = _varint(content, at)
    return value >> 1 ^ -(value & 1), at


def _varint(content: _Content, at: int) -> tuple[int, int]:
    """Seven bits a byte, the lowest first; the last byte is below 128."""
    value = shift = 0
    while True:
        byte = content[at]
        value |= (byte & 127) << shift
        at, shift = at + 1, shift + 7
        if byte < 128:
            return value, at
        if shift > 63:
            raise ValueError("a header of a page has a number that does not end")
