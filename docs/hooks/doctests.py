"""A griffe extension: docstrings' doctests become code blocks of the API pages."""

from __future__ import annotations

import re

import griffe

_BARE = re.compile(r"^>>> .*(?:\n(?!\s*$).+)*", re.MULTILINE)


class CodeBlocks(griffe.Extension):
    """Names the sections as griffe's parser expects, and fences doctests that stand in no section."""

    def on_object(self, *, obj: griffe.Object, **_: object) -> None:
        """Rewrite the docstring of each object loaded."""
        if obj.docstring is not None:
            text = re.sub(r"^Example:$", "Examples:", obj.docstring.value, flags=re.MULTILINE)
            obj.docstring.value = _BARE.sub(lambda block: f"```pycon\n{block[0]}\n```", text)
