"""The pages: templates that are filled in, and appear on disk whole or not at all."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from pzcap.io.files import write_bytes


def write(path: Path, template: str, context: Mapping[str, Any]) -> None:
    """Write a page of experiments/templates/, which needs no network.

    All text is escaped, whoever wrote it; only `markupsafe.Markup`, such as the drawings of `experiments.plots`, is
    taken as it is. (Jinja's own choice by the file's ending takes ``.html.j2`` for no page.)
    """
    environment = Environment(
        loader=PackageLoader("experiments"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    page = environment.get_template(template).render(context)
    write_bytes(path, page.encode(errors="replace"))  # names may hold what no text does
