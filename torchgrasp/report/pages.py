"""Pages from the templates beside this file: every text is escaped, and a page needs nothing but itself."""

from __future__ import annotations

import base64
from functools import cache
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from torchgrasp.errors import printable


def render_page(template: str, **values: Any) -> str:
    """The HTML document that `templates/<template>.html.j2` makes of `values`."""
    return _environment().get_template(f"{template}.html.j2").render(values)


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("torchgrasp.report"),
        autoescape=True,
        # Marks that turn the direction of writing hide what a name is, escaped or not.
        finalize=lambda value: printable(value) if type(value) is str else value,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters["base64"] = lambda content: base64.b64encode(content).decode()
    return environment
