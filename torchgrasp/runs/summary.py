"""summary.json of a run, as it is written and read again: what was measured, and on which machine."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BeforeValidator, Field, JsonValue

from torchgrasp.documents import Amount, Count, Name, OpenDocument, Rate


def _as_list(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value


# Given as a list or a pair, a list in JSON.
_Interval = Annotated[list[Rate], BeforeValidator(_as_list), Field(min_length=2, max_length=2)]


class ObjectRow(OpenDocument):
    """Of one object."""

    episodes: Count
    successes: Count


class Success(OpenDocument):
    """A success table, as SuccessTable.summary tells it.

    Attributes:
        success_rate: in [0, 1].
        success_ci95: the ends of its 95 % interval.
        episodes: that it was measured on.
        objects: by name.
        outcomes: a 1 for each success and a 0 for each failure, in the order of the scenes; empty in files of
            earlier versions.
    """

    success_rate: Rate
    success_ci95: _Interval
    episodes: Count
    objects: dict[Name, ObjectRow]
    outcomes: Annotated[str, Field(pattern=r"^[01]*$")] = ""


class Summary(Success):
    """What every recipe that evaluates tells; some tell more.

    Attributes:
        wall_seconds: of the whole run.
        env_steps: of training, or of the evaluation.
        gradient_steps: of training.
        versions: of Python and packages.
        hardware: of the machine.
        comparison: success tables of the policy and of others, by name.
    """

    wall_seconds: Amount
    env_steps: Count
    gradient_steps: Count
    versions: dict[Name, Name]
    hardware: dict[Name, JsonValue]
    comparison: dict[Name, Success] = Field({})
