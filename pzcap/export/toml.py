"""TOML of plain tables, as far as calibrations and settings need it. The standard library reads TOML, and writes none;
JSON's texts, numbers, lists and truth values are TOML's as well."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any


def toml(tables: Mapping[str, Mapping[str, Any]]) -> str:
    """Tables of texts, finite numbers, truth values and lists of these."""
    return "\n".join(
        f"[{name if name.replace('_', '').isalnum() and name.isascii() else json.dumps(name)}]\n"
        + "".join(f"{key} = {json.dumps(value)}\n" for key, value in table.items())
        for name, table in tables.items()
    )
