"""Documents: files of JSON or YAML that anyone may have written, read against a schema in one strict way.

Each document's schema stands beside the code that writes it, and what is written passes through it too.
"""

from __future__ import annotations

import json
import reprlib
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from typing import Annotated, Any, TypeVar

import yaml
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, JsonValue, ValidationError

from torchgrasp.errors import CheckpointError, DamageError, TorchgraspError

# A card of a million episodes fits; values of JSON take some 30 times as much memory as their text.
_MAX_BYTES = 1 << 24
_MAX_YAML = 1 << 20
_MAX_DEPTH = 64
_MAX_NAME = 255


class Document(BaseModel):
    """A mapping with these keys and no other, of these types as they are: nothing is converted."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


class OpenDocument(Document):
    """A mapping with these keys at least; further ones hold any plain values."""

    __pydantic_extra__: dict[str, JsonValue] = Field(init=False)
    model_config = ConfigDict(extra="allow", strict=True, frozen=True)


def _check_relative(path: str) -> str:
    parts = PurePosixPath(path).parts
    if not parts or path.startswith("/"):
        raise ValueError("a relative path is expected")
    if not path.isprintable() or max(len(part.encode()) for part in parts) > _MAX_NAME:
        raise ValueError("no such file can be: its name is too long, or not of printable characters")
    return path


def _check_inside(path: str) -> str:
    if path != "/".join(PurePosixPath(_check_relative(path)).parts) or ".." in PurePosixPath(path).parts:
        raise ValueError("a path inside the folder is expected, plain and without ..")
    return path


# Whole numbers that a double holds exactly: more of anything is an absurd number.
Count = Annotated[int, Field(ge=0, le=2**53)]
Whole = Annotated[int, Field(ge=-(2**63), lt=2**63)]
Crc32 = Annotated[int, Field(ge=0, lt=2**32)]
Rate = Annotated[float, Field(ge=0.0, le=1.0, allow_inf_nan=False)]
Amount = Annotated[float, Field(ge=0.0, le=1e15, allow_inf_nan=False)]
Name = Annotated[str, Field(max_length=1000)]
Text = Annotated[str, Field(max_length=1_000_000)]
RelativePath = Annotated[str, Field(max_length=4096), AfterValidator(_check_relative)]
# Below the folder that the document lies in.
InnerPath = Annotated[str, Field(max_length=1024), AfterValidator(_check_inside)]
Plain = dict[str, JsonValue]

_D = TypeVar("_D", bound=Document)


def read_document(
    path: str | Path, schema: type[_D], remedy: str, *, error: type[TorchgraspError] = CheckpointError
) -> _D:
    """Read the JSON file `path`; `error` names it, what is wrong with it, and the `remedy`.

    Refused are files that are too large, no UTF-8 or no strict JSON (a name given twice, nested too deep, a
    number beyond what JSON readers take), and values that the schema does not have.
    """
    return check_document(read_json(path, remedy, error=error), schema, path, remedy, error=error)


def read_json(path: str | Path, remedy: str, *, error: type[TorchgraspError] = CheckpointError) -> Any:
    """Read the JSON file `path` without a schema; see `read_document`."""
    return parse_json(read_text(path, remedy, error=error), path, remedy, error=error)


def check_document(
    value: Any,
    schema: type[_D],
    source: str | Path,
    remedy: str,
    *,
    error: type[TorchgraspError] = CheckpointError,
) -> _D:
    """What `schema` makes of a plain `value`; `error` names the `source` and the first fault."""
    try:
        return schema.model_validate(value)
    except ValidationError as fault:
        raise error(f"{source} cannot be used ({_tell(fault)}): {remedy}.") from fault


def parse_json(
    text: str, source: str | Path, remedy: str, *, error: type[TorchgraspError] = CheckpointError
) -> Any:
    """Plain values of strict JSON, but that NaN and infinities may stand for numbers."""
    try:
        if len(text) > _MAX_BYTES:
            raise ValueError(f"it has more than {_MAX_BYTES} characters")
        value = json.loads(text, object_pairs_hook=_refuse_twins)
        _check_tree(value)
        return value
    except (ValueError, RecursionError) as fault:
        raise error(f"{source} cannot be used ({_shorten(fault)}): {remedy}.") from fault


def read_yaml(path: str | Path, remedy: str) -> Any:
    """Read the YAML file `path` with plain values; CheckpointError names what is wrong with it."""
    return parse_yaml(read_text(path, remedy, at_most=_MAX_YAML), path, remedy)


def parse_yaml(text: str, source: str | Path, remedy: str) -> Any:
    """Plain values of YAML without references, which could stand for endless data, nested 64 deep at most."""
    try:
        depth = 0
        for event in yaml.parse(text, Loader=yaml.SafeLoader):
            if isinstance(event, yaml.AliasEvent):
                raise ValueError("it refers to its own parts by *, which no file of a run does")
            depth += isinstance(event, yaml.CollectionStartEvent)
            depth -= isinstance(event, yaml.CollectionEndEvent)
            if depth > _MAX_DEPTH:
                raise ValueError(f"it is nested more than {_MAX_DEPTH} deep")
        return yaml.safe_load(text)
    except (ValueError, TypeError, RecursionError, yaml.YAMLError) as fault:
        raise CheckpointError(f"{source} cannot be used ({_shorten(fault)}): {remedy}.") from fault


def read_text(
    path: str | Path,
    remedy: str,
    *,
    error: type[TorchgraspError] = CheckpointError,
    at_most: int = _MAX_BYTES,
) -> str:
    """The text of a file of UTF-8; `error` names what is wrong with it before more than `at_most` is read."""
    path = Path(path)
    with reading(path, remedy):
        mode = path.stat().st_mode
        if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):  # a pipe or a device could be read for ever
            raise error(f"{path} is no regular file: {remedy}.")
        with path.open("rb") as stream:
            content = stream.read(at_most + 1)
    try:
        if len(content) > at_most:
            raise ValueError(f"it has more than {at_most} bytes")
        text = content.decode()
        if text.startswith("\ufeff"):
            raise ValueError("it begins with a byte order mark: save it as UTF-8 without one")
        return text
    except ValueError as fault:
        raise error(f"{path} cannot be used ({_shorten(fault)}): {remedy}.") from fault


@contextmanager
def reading(path: Path, remedy: str) -> Iterator[None]:
    """Tell what is missing from what only cannot be read now: rights, open files, a disk's fault."""
    try:
        yield
    except (FileNotFoundError, NotADirectoryError, IsADirectoryError) as fault:
        raise DamageError(f"{path} is missing: {remedy}.") from fault
    except (OSError, ValueError) as fault:  # ValueError: a name that no file can have
        reason = getattr(fault, "strerror", None) or fault
        raise CheckpointError(
            f"{path} cannot be read ({reason}), which does not mean that it is damaged: mend that, "
            "then try again."
        ) from fault


def shorten(value: object) -> str:
    """A value that a file holds, in a few words that fit a message."""
    return reprlib.repr(value)


def _refuse_twins(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        seen: set[str] = set()
        twin = next(name for name, _ in pairs if name in seen or seen.add(name))
        raise ValueError(f"{shorten(twin)} is there twice")
    return found


def _check_tree(value: Any) -> None:
    """Refuse trees that are too deep, and text that is not Unicode."""
    level = [value]
    for _ in range(_MAX_DEPTH):
        following: list[Any] = []
        for each in level:
            if isinstance(each, dict):
                following += each
                following += each.values()
            elif isinstance(each, list):
                following += each
            elif isinstance(each, str):
                each.encode()  # half of a surrogate pair is refused
        level = following
        if not level:
            return
    raise ValueError(f"it is nested more than {_MAX_DEPTH} deep")


def _tell(error: ValidationError) -> str:
    """The first fault and its place."""
    faults = error.errors(include_url=False)
    missing = [".".join(map(str, each["loc"])) for each in faults if each["type"] == "missing"]
    fault = faults[0]
    place = ".".join(map(str, fault["loc"]))[:200] or "it"
    if fault["type"] == "missing":
        return f"it lacks {', '.join(missing)[:200]}"
    if fault["type"] == "extra_forbidden":
        return f"{place} is no entry of it"
    reason = fault["msg"].removeprefix("Value error, ").removeprefix("Input should be ")
    return f"{place}={shorten(fault['input'])}, expected: {reason}"


def _shorten(fault: Exception) -> str:
    return " ".join(str(fault).split())[:200] or type(fault).__name__
