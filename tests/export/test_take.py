"""Names of exported files."""

from __future__ import annotations

import pytest

from pzcap.export.take import _unlike, plain


@pytest.mark.parametrize(
    ("name", "file"), [("Übung Maß 1", "Ubung_Mass_1"), ("à côté", "a_cote"), ("a/b", "a_b"), ("体操", "")]
)
def test_names_of_files_are_read_by_every_tool(name: str, file: str) -> None:
    assert plain(name) == file


def test_cameras_of_like_names_have_files_of_their_own() -> None:
    assert _unlike(["a", "b", "a"]) == ["a_1", "b", "a_3"]
    assert _unlike(["a", "a", "a_1"]) == ["a_1_", "a_2", "a_1"]
