"""What the tables of a document are written as; apart from the writers, for the parser of arguments loads it."""

from __future__ import annotations

from enum import StrEnum


class Format(StrEnum):
    """A format of tables; the value is its word on the command line, and the ending of its files."""

    PARQUET = "parquet"
    CSV = "csv"
    MARKDOWN = "md"
    LATEX = "tex"
