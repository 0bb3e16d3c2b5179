"""The configuration reference, from the dataclasses that are the configuration: docs/configuration.md.

    python -m experiments.settings_reference      # prints it; `make docs` writes it

A setting is described by the docstring under it in the source, a group by the docstring of its class.
"""

from __future__ import annotations

import ast
import inspect
import itertools
import json
import textwrap
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from typing import Any, Final, get_type_hints

from experiments.config import CONVERTER, AppConfig
from sim.ranges import Range

HEAD = """# Configuration

Everything that `python -m experiments.run` can be told, with its default. `shoot` decides what is filmed, `reconstruct`
how it is estimated, `output` what is left behind. A setting is given as `key=value`, values to sweep over as `key=a,b`.
"""
BAR: Final = r"\|"  # in a cell of a table


def markdown() -> str:
    """The whole page: a section a group, a row a setting."""
    return "\n".join([HEAD, *_sections(AppConfig, "", CONVERTER.unstructure(AppConfig()))])


def descriptions(kind: type = AppConfig, prefix: str = "") -> dict[str, str]:
    """Dotted key -> the docstring under it, of every setting that has one."""
    written = [base for base in reversed(kind.__mro__) if is_dataclass(base)]
    texts = {name: text for base in written for name, text in _texts(base).items()}
    hints, found = get_type_hints(kind), {prefix + name: text for name, text in texts.items()}
    for field in fields(kind):
        if is_dataclass(hints[field.name]):
            found |= descriptions(hints[field.name], f"{prefix}{field.name}.")
    return found


def _sections(kind: type, path: str, defaults: Mapping[str, Any]) -> Iterator[str]:
    hints, told = get_type_hints(kind), descriptions()
    groups = [field.name for field in fields(kind) if is_dataclass(hints[field.name])]
    yield f"## `{path}`\n" if path else "## The root\n"
    yield f"{inspect.cleandoc(_documented(kind))}\n"
    keys = {f"{path}.{name}".lstrip("."): value for name, value in defaults.items() if name not in groups}
    rows = [
        f"| `{key}` | `{json.dumps(value)}` | {_range(kind, key)} | {told.get(key, '').replace('|', BAR)} |"
        for key, value in keys.items()
    ]
    if rows:
        yield "\n".join(["| key | default | range | |", "|---|---|---|---|", *rows, ""])
    for name in groups:
        yield from _sections(hints[name], f"{path}.{name}".lstrip("."), defaults[name])


def _range(kind: type, key: str) -> str:
    hint = get_type_hints(kind, include_extras=True)[key.rpartition(".")[2]]
    return ", ".join(str(each) for each in getattr(hint, "__metadata__", ()) if isinstance(each, Range))


def _documented(kind: type) -> str:
    """The docstring, unless it is the one that dataclasses make up."""
    text = kind.__doc__ or ""
    return "" if text.startswith(f"{kind.__name__}(") else text


def _texts(kind: type) -> dict[str, str]:
    """Field -> the docstring under it, on one line."""
    (definition,) = ast.parse(textwrap.dedent(inspect.getsource(kind))).body
    assert isinstance(definition, ast.ClassDef)
    return {
        line.target.id: " ".join(text.value.value.split())
        for line, text in itertools.pairwise(definition.body)
        if isinstance(line, ast.AnnAssign) and isinstance(line.target, ast.Name)
        and isinstance(text, ast.Expr) and isinstance(text.value, ast.Constant) and isinstance(text.value.value, str)
    }  # fmt: skip


if __name__ == "__main__":
    print(markdown())
