"""Text of a table whatever program wrote it: its encoding, and what is no table at all."""

from __future__ import annotations

import codecs
import csv
import os
import re
from collections.abc import Iterator
from pathlib import Path

#: How files of other kinds begin, and what to do with them.
OTHERS = {
    b"PK\x03\x04": "an Excel workbook or another archive; save it as CSV",
    b"\xd0\xcf\x11\xe0": "an Excel workbook; save it as CSV",
    b"\x89HDF": "an HDF5 file; read it with h5py and give its arrays to Episodes.from_arrays",
    b"MATLAB 5.0": "a MATLAB file; read it by Episodes.from_mat",
    b"PAR1": "a Parquet file; read it with pandas and give its arrays to Episodes.from_arrays",
    b"#ROSBAG": "a ROS bag; export its topics as CSV",
    b"SQLite format 3": "a database, such as a ROS 2 bag; export its topics as CSV",
    b"\x89MCAP": "an MCAP log; export its topics as CSV",
    b"\x1f\x8b": "compressed; unpack it first",
}
MARKS = {
    codecs.BOM_UTF8: "utf-8-sig",
    codecs.BOM_UTF16_LE: "utf-16",
    codecs.BOM_UTF16_BE: "utf-16",
}
DELIMITERS = (",", ";", "\t", "|", " ")
#: A line that is one quoted cell with delimiters inside.
WHOLE_LINE = re.compile(r'"[^"]*[,;\t|][^"]*"')


def text_of(path: str | os.PathLike[str], encoding: str | None = None) -> str:
    """The text of the file ``path``.

    encoding  by name; default: what its first bytes say, or UTF-8, or else Latin-1 as Windows writes it

    Raises FileNotFoundError if it is missing, and ValueError for files that are no text, or of another encoding.
    """
    place = Path(path)
    if place.is_dir():
        raise ValueError(f"{place} is a folder; give a file, or a pattern such as {place / '*.csv'}")
    if not place.is_file():
        raise FileNotFoundError(f"{place} does not exist; expected a table with a header line")
    content = place.read_bytes()
    for beginning, what in OTHERS.items():
        if content.startswith(beginning):
            raise ValueError(f"{place} is {what}")
    for name in [encoding] if encoding is not None else _encodings(content):
        try:
            return unwrapped(content.decode(name))
        except UnicodeDecodeError:
            continue
        except LookupError:
            raise ValueError(f"encoding = {name!r} is unknown; expected a name such as 'utf-8' or 'latin-1'") from None
    wanted = "text" if encoding is None else f"text in {encoding}"
    raise ValueError(f"{place} is no {wanted}; save it as UTF-8, or give its encoding=")


def unwrapped(text: str) -> str:
    """The ``text`` of a table without quotes around whole lines; spreadsheets put them where they cut none."""
    first = [line for line in text[:20_000].splitlines()[:20] if line]
    if len(first) < 3 or not all(WHOLE_LINE.fullmatch(line) for line in first[:-1]):
        return text
    return "\n".join(line[1:-1] if WHOLE_LINE.fullmatch(line) else line for line in text.splitlines()) + "\n"


def _encodings(content: bytes) -> list[str]:
    for mark, name in MARKS.items():
        if content.startswith(mark):
            return [name]
    start = content[:1000]
    if start.count(0) > 0.3 * len(start):  # every other byte of plain words
        return ["utf-16-be" if start[:2][:1] == b"\x00" else "utf-16-le"]
    return [] if 0 in start else ["utf-8", "cp1252", "latin-1"]


def rows_of(text: str, delimiter: str, limit: int | None = None) -> Iterator[tuple[int, list[str]]]:
    """Number and stripped cells of the lines of ``text``, blank ones with no cells.

    delimiter  one character; blanks in any number are one where it is " "
    limit      lines that are read; default: all

    Raises ValueError for quotes that do not end, and other damage.
    """
    lines = text.splitlines(keepends=True)
    if limit is not None:
        lines = lines[:limit]
    if delimiter == " ":
        for number, line in enumerate(lines, 1):
            yield number, line.split()
        return
    reader = csv.reader(lines, delimiter=delimiter)
    try:
        for row in reader:
            cells = [cell.strip() for cell in row]
            yield reader.line_num, cells if any(cells) else []
    except csv.Error as error:
        raise ValueError(f"line {reader.line_num} is no row of a table: {error}") from None
