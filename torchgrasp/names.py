"""Names, paths and words that come from outside, made fit for terminals, files and messages."""

from __future__ import annotations

import io
import os
import re
import sys
import unicodedata
from pathlib import Path

from torchgrasp.errors import ConfigError, printable

# File systems take 255 bytes a name; a key and a suffix come behind.
_STEM = 60


def one_line(text: object) -> str:
    """The text of a value as a single printable line."""
    return printable(" ".join(str(text).split()))


def object_name(relative: Path) -> str:
    r"""The name of an object that lies at a path: printable, the same on every system, `/` between folders.

    A name that is not UTF-8, as old archives leave them, keeps its bytes as `\xe9`. Accents are composed;
    macOS takes them apart.
    """
    text = os.fsencode(relative.as_posix()).decode("utf-8", "backslashreplace")
    return printable(unicodedata.normalize("NFC", text))


def file_stem(name: str) -> str:
    """The last part of a name as the beginning of a file's: ASCII alone, at most 60 characters.

    >>> file_stem("kitchen/café mug")
    'caf__mug'
    """
    return re.sub(r"[^A-Za-z0-9._-]", "_", name.rsplit("/", 1)[-1])[:_STEM]


def to_path(argument: str, value: object) -> Path:
    """The path that somebody gave for `argument`, with `~` expanded; ConfigError where it is none."""
    if not isinstance(value, str | os.PathLike):
        raise ConfigError(f"{argument}={value!r} is no path: give one as text, such as './{value}'.")
    if "\0" in os.fspath(value):
        raise ConfigError(f"{argument}={os.fspath(value)!r} holds a null character: give a path without.")
    try:
        return Path(value).expanduser()
    except RuntimeError as error:
        raise ConfigError(
            f"{argument}={str(value)!r}: no home directory is known ({error}): write the path without ~."
        ) from error


def write_out_what_cannot_be_encoded() -> None:
    r"""Let standard output show as `\u0436` what its encoding lacks, as standard error does anyway."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")
