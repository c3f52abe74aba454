"""A record: what one command gave, and where it was measured."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from torchgrasp.documents import Count, Document, Name, Plain

ROOT = Path(__file__).parents[2]
RESULTS = Path(__file__).parent
NOT_RECORDED = "not recorded"
Words = Annotated[str, Field(min_length=1, max_length=4000)]


class Record(Document):
    """What one command gave.

    Attributes:
        command: as it is typed in a checkout, `<run>` and `<folder>` for what it needs beside it.
        commit: short hash of the version that gave the figures.
        commit_is: "measured" where that version gave them; "recorded" where only the commit is known that
            wrote them down, and the version that gave them is that one or an earlier one.
        seed: of the run, or of its training; None where it was not written down or there are several.
        machine: in words.
        versions: of torchgrasp, and of what else is known.
        recorded: "run" where a run's own file was read, "page" where the figures come from a page's text.
        needs: other commands that the figures took: those that made what `<run>` and `<folder>` stand for,
            or what is compared with.
        note: what else must be known to read the figures, in parts that `; ` divides: the line below a
            table shows them.
        rows: the values.
    """

    command: Words
    commit: Annotated[str, Field(pattern=r"^[0-9a-f]{7,40}$")]
    commit_is: Literal["measured", "recorded"] = "measured"
    seed: Count | None = None
    machine: Words
    versions: Annotated[dict[Name, Name], Field(min_length=1)]
    recorded: Literal["run", "page"]
    needs: list[Words] = Field([])
    note: Name = ""
    rows: Annotated[list[Plain], Field(min_length=1)]
