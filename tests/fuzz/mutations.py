"""Strategies that damage a file: byte by byte, value by value, and array by array."""

from __future__ import annotations

import io
import json
import struct
from copy import deepcopy
from typing import Any

import numpy as np
from hypothesis import strategies as st

NUMBERS = (0, 1, -1, 2**31 - 1, -(2**31), 2**32 - 1, 2**63, 10**40, 0.0, -0.0, 0.5, 1e-300, 1e300, 1e308)
TEXTS = (
    "", " ", "x", "../x", "/etc/passwd", "a/../../b", "\0", "\n", "[/b]", "<script>", "é", "\ud800",
    "1e1000000000", "1/0",
    "30", "30000/1001", "-30/1", "DICT_4X4_50", "DICT_", "99:99:99:99", "10:00:00;00", "10:00:00:00", "1" * 5000,
    "/dev/zero",
)  # fmt: skip
VALUES: tuple[Any, ...] = (
    None, True, False, float("nan"), float("inf"), [], {}, [[]], [None], {"": None}, [0] * 1000, *NUMBERS, *TEXTS,
)  # fmt: skip
TOKENS = ("nan", "inf", "-", "{", "}", "JOINT", "End Site", "\0", "é", ";", '"', "1e999")
ARRAY_KINDS = ("nan", "huge", "fewer", "flat", "text", "int", "complex", "scalar", "none", "out", "more")
BOXES = (
    b"mvhd", b"tkhd", b"mdhd", b"elst", b"stts", b"ctts", b"stsz", b"stsc", b"stco", b"stsd", b"avc1", b"tmcd", b"hdlr",
)  # fmt: skip
WORDS = (b"\0\0\0\0", b"\xff\xff\xff\xff", b"\x7f\xff\xff\xff", b"\x80\0\0\0", b"\0\0\0\x01", b"\xff", b"\0")


@st.composite
def damaged_bytes(draw: st.DrawFn, content: bytes) -> bytes:
    """Some bytes of a file changed for others, for numbers at the edge of their range, cut off, doubled or left out."""
    data = bytearray(content)
    for _ in range(draw(st.integers(1, 4))):
        if not data:
            break
        at = draw(st.integers(0, len(data) - 1))
        kind = draw(st.sampled_from(("byte", "word", "cut", "out", "twice", "noise")))
        length = draw(st.integers(1, 64))
        if kind == "byte":
            data[at] = draw(st.integers(0, 255))
        elif kind == "word":
            word = draw(st.sampled_from(WORDS))
            data[at : at + len(word)] = word
        elif kind == "cut":
            del data[at:]
        elif kind == "out":
            del data[at : at + length]
        elif kind == "twice":
            data[at:at] = data[at : at + length]
        else:
            data[at : at + length] = draw(st.binary(min_size=length, max_size=length))
    return bytes(data)


@st.composite
def changed_tree(draw: st.DrawFn, tree: Any) -> Any:
    """Plain data with some values changed for others, left out, doubled, or put one deeper."""
    copy = {"": json.loads(json.dumps(tree))}
    for _ in range(draw(st.integers(1, 3))):
        node: Any = copy
        key: Any = ""
        while isinstance(node[key], dict | list) and node[key] and draw(st.integers(0, 3)):
            node = node[key]
            key = draw(st.sampled_from(sorted(node) if isinstance(node, dict) else range(len(node))))
        kind = draw(st.sampled_from(("value", "value", "number", "out", "twice", "deeper", "renamed")))
        if kind == "value":
            node[key] = deepcopy(draw(st.sampled_from(VALUES)))  # what comes next may change it
        elif kind == "number" and isinstance(node[key], int | float):
            node[key] = node[key] * draw(st.sampled_from((-1, 0, 10, 1000, 1e-6, 1e9)))
        elif kind == "out" and node is not copy:
            del node[key]
        elif kind == "twice" and isinstance(node, list):
            node.insert(key, json.loads(json.dumps(node[key])))
        elif kind == "deeper":
            node[key] = [node[key]]
        elif kind == "renamed" and isinstance(node, dict) and node is not copy:
            node[draw(st.sampled_from(TEXTS))] = node.pop(key)
        if not isinstance(copy.get(""), dict | list):
            break
    return copy[""]


def changed_json(content: bytes) -> st.SearchStrategy[bytes]:
    """A JSON file with its values changed; now and then with its bytes."""
    tree = json.loads(content)
    written = changed_tree(tree).map(lambda changed: json.dumps(changed).encode())
    return st.one_of(written, written, damaged_bytes(content))


@st.composite
def changed_arrays(draw: st.DrawFn, content: bytes) -> bytes:
    """An npz file with arrays of other shapes, types and values, missing or more."""
    with np.load(io.BytesIO(content)) as found:
        arrays: dict[str, Any] = dict(found)
    for _ in range(draw(st.integers(1, 3))):
        name = draw(st.sampled_from(sorted(arrays)))
        array = arrays[name]
        kind = draw(st.sampled_from(ARRAY_KINDS))
        if kind in ("nan", "huge", "int") and array.dtype.kind in "Uc":
            array = np.zeros(array.shape)  # it was made something else before
        if kind in ("nan", "huge"):
            array = array.astype(np.float64)
            array.flat[: draw(st.integers(1, 9))] = (
                np.nan if kind == "nan" else draw(st.sampled_from((1e300, -1e300, 1e9)))
            )
        elif kind == "fewer":
            array = array[: max(0, len(array) - 1)] if array.ndim else array
        elif kind == "flat":
            array = array.ravel()
        elif kind == "text":
            array = array.astype(str)
        elif kind == "int":
            array = np.nan_to_num(array).clip(-100, 100).astype(np.int8)
        elif kind == "complex":
            array = array.astype(complex)
        elif kind == "scalar":
            array = np.float64(3.0)
        elif kind == "none":
            array = array[:0] if array.ndim else array
        arrays[name] = array
        if kind == "out":
            del arrays[name]
        elif kind == "more":
            arrays[f"{name}_"] = array
        if not arrays:
            break
    out = io.BytesIO()
    np.savez(out, **arrays)
    return out.getvalue()


@st.composite
def changed_words(draw: st.DrawFn, content: bytes) -> bytes:
    """A text of words and numbers, some of them changed, left out or doubled; lines, too."""
    lines = content.decode().split("\n")
    for _ in range(draw(st.integers(1, 4))):
        at = draw(st.integers(0, len(lines) - 1))
        separator = "," if "," in lines[at] else " "
        words = lines[at].split(separator)
        word = draw(st.integers(0, len(words) - 1))
        kind = draw(st.sampled_from(("word", "number", "out", "twice", "line", "lines", "empty")))
        if kind == "word":
            words[word] = draw(st.sampled_from(TOKENS))
        elif kind == "number":
            words[word] = str(draw(st.sampled_from(NUMBERS)))
        elif kind == "out":
            del words[word]
        elif kind == "twice":
            words.insert(word, words[word])
        lines[at] = separator.join(words)
        if kind == "line":
            del lines[at]
        elif kind == "lines":
            lines.insert(at, lines[at])
        elif kind == "empty":
            lines[at] = ""
        lines = lines or [""]
    return "\n".join(lines).encode()


@st.composite
def changed_boxes(draw: st.DrawFn, content: bytes) -> bytes:
    """An MP4 whose tables say other numbers: sizes, counts, times."""
    data = bytearray(content)
    for _ in range(draw(st.integers(1, 3))):
        at = data.find(draw(st.sampled_from(BOXES)))
        if at >= 0:
            place = at + 4 * draw(st.integers(-1, 12))
            number = draw(
                st.one_of(st.sampled_from((0, 1, 2, 2**16, 2**31 - 1, 2**31, 2**32 - 1)), st.integers(0, 2**32 - 1))
            )
            if 0 <= place <= len(data) - 4:
                struct.pack_into(">I", data, place, number)
    return bytes(data)
