"""Documents with one value that does not belong there, as damage or somebody who means harm would leave."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable, Iterator
from itertools import islice
from typing import Any

import pytest

from torchgrasp.errors import TorchgraspError

_DEEP: list = []
for _ in range(80):
    _DEEP = [_DEEP]
VALUES = {
    "null": None,
    "list": [],
    "mapping": {"x": 1},
    "negative": -1,
    "1e23": 1e23,
    "huge": 10**30,
    "not finite": float("nan"),
    "text": "../../x",
    "switch": True,
    "deep": _DEEP,
}
# YAML of a few lines that stands for 2^9 lists, and with a few more for any number.
YAML_BOMB = "a: &a [1, 1]\n" + "".join(
    f"{new}: &{new} [*{old}, *{old}]\n" for old, new in zip("abcdefgh", "bcdefghi", strict=True)
)
# Text of a file that is no document at all.
TEXTS = {
    "empty": b"",
    "cut": b'{"format": 2',
    "mark": b"\xef\xbb\xbf{}",
    "two bytes a letter": "{}".encode("utf-16"),
    "no text": bytes(range(256)),
    "another value": b"[3]",
    "nothing": b"null",
    "twins": b'{"format": 2, "format": 2}',
    "half a letter": b'{"\\ud800": 2}',
    "deep": b"[" * 100_000,
    "long": b" " * (1 << 25),
    "digits": b"9" * 10_000,
}


def spoil(document: Any) -> Iterator[tuple[str, Any]]:
    """(words, the document with one value replaced, left out or added), for every place in it."""
    for place in list_places(document):
        for name, value in VALUES.items():
            if not _is_like(value, _get(document, place)):
                yield f"{'.'.join(map(str, place))}: {name}", _set(document, place, value)
        if place:
            yield f"{'.'.join(map(str, place))}: left out", _set(document, place, _set)
        if isinstance(_get(document, place), dict):
            yield f"{'.'.join(map(str, place))}: more", _set(document, (*place, "more"), 1)


def list_places(document: Any, place: tuple = ()) -> Iterator[tuple]:
    """Each place in a nested document, by keys and numbers; of long lists the first two entries."""
    yield place
    if isinstance(document, dict):
        for key, value in document.items():
            yield from list_places(value, (*place, key))
    elif isinstance(document, list):
        for number, value in enumerate(document[:2]):
            yield from list_places(value, (*place, number))


def _is_like(value: Any, original: Any) -> bool:
    """Whether a value could stand there: of the same type, and neither absurd nor negative."""
    if type(value) is not type(original):
        return False
    return isinstance(value, str | bool) or value == original or (type(value) is list and not original)


def _get(document: Any, place: tuple) -> Any:
    for key in place:
        document = document[key]
    return document


def _set(document: Any, place: tuple, value: Any) -> Any:
    if not place:
        return value
    document = copy.deepcopy(document)
    parent = _get(document, place[:-1])
    if value is _set:
        del parent[place[-1]]
    else:
        parent[place[-1]] = value
    return document


def check_each(
    document: Any,
    write: Callable[[Any], None],
    read: Callable[[], Any],
    *,
    free: Callable[[str], bool],
    every: int = 1,
) -> int:
    """Write each spoilt document, and see that reading it is one error of ours; returns how many there were.

    Args:
        document: that is whole.
        write: puts a document where `read` finds it, checksums renewed.
        read: what must refuse.
        free: of the words of `spoil`, whether anything may stand there.
        every: one of so many is tried.
    """
    number = 0
    for words, spoilt in islice(spoil(document), 0, None, every):
        write(spoilt)
        try:
            read()
        except TorchgraspError as error:
            assert len(str(error)) < 1500, words
        except Exception as error:
            raise AssertionError(f"{words}: {type(error).__name__}: {error}") from error
        else:
            assert free(words), f"{words} was accepted: {json.dumps(spoilt)[:300]}"
        number += 1
    write(document)
    read()
    return number


def check_texts(path: Any, read: Callable[[], Any]) -> None:
    """See that a file of each kind of no document is refused, by its name."""
    for words, content in TEXTS.items():
        path.write_bytes(content)
        with pytest.raises(TorchgraspError) as error:
            read()
        assert path.name in str(error.value), words
        assert "\n" not in str(error.value), words
