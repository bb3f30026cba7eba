"""The template environment of the reports, and the format of numbers."""

import re

import jinja2
from markupsafe import Markup, escape


def render(name: str, **context: object) -> str:
    """Render a template below `scenarios/`; undefined names are errors, and all texts are escaped."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("scenarios", ""),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"number": _number, "code": _code}
    return environment.get_template(name).render(context)


def _number(value: float | None, digits: int) -> str:
    return "–" if value is None else f"{value:.{digits}f}"


def _code(line: str) -> Markup:
    """A line in which what stands between backticks is code."""
    return Markup(re.sub("`(.*?)`", r"<code>\1</code>", str(escape(line))))
