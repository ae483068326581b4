"""Mutations of valid inputs: bytes, words of texts, values of JSON documents."""

from __future__ import annotations

import json
from collections.abc import Sequence
from random import Random
from typing import Any

NUMBERS = (
    *("0", "-0", "1", "-1", "2", "255", "256", "65535", "65536", "2147483647", "2147483648"),
    *(
        "-2147483648",
        "4294967295",
        "9223372036854775807",
        "18446744073709551616",
        "1e308",
        "1e-308",
    ),
    *("1e999", "-1e999", "nan", "NaN", "inf", "-inf", "Infinity", "0x10", "1_0", "1,5", "٣", "½"),
    *("1e-400", "0.1", "1.", ".5", "--1", "+1", "9" * 400, "9" * 5000),
)
WORDS = (
    *("", " ", "\t", "\r\n", "\n\n", "\0", "\ufeff", "é", "\U0001f600", "null", "true", "None"),
    *("{}", "[]", '"', "'", "\\", "/", "..", "../../etc/passwd", "/etc/passwd", "#", "%s", "$HOME"),
    *("a" * 300, "a" * 100_000, "-", "=", ",", ";", ":"),
)
BYTES = (b"\x00", b"\xff", b"\x00" * 8, b"\xff" * 8, b"\x7f\xff\xff\xff", b"\x80\x00\x00\x00")
VALUES: tuple[Any, ...] = (
    *(None, True, False, 0, -1, 1, 2**31, 2**63, 2**64, 10**400, 1e308, -1e308, 0.5, 1e-308),
    *(float("nan"), float("inf"), "", "x", "nan", "\ud800", [], {}, [[]], [1, [2]], {"a": {}}),
    *([0.0] * 9, [[1, 0, 0], [0, 1, 0], [0, 0, 1]], [[0] * 3] * 3, "a" * 10_000),
)


def mutate_bytes(random: Random, data: bytes) -> bytes:
    """Flip, replace, insert, remove, repeat or cut bytes, once or several times."""
    out = bytearray(data)
    for _ in range(random.choice((1, 1, 1, 2, 4, 16))):
        at = random.randrange(len(out) + 1) if out else 0
        if random.random() < 0.3:
            at = min(at, random.randrange(200))  # headers are at the start
        what = random.randrange(7)
        span = min(random.choice((1, 2, 4, 8, 64, 1024)), len(out) - at)
        if what == 0 and at < len(out):
            out[at] ^= 1 << random.randrange(8)
        elif what == 1:
            value = random.choice(BYTES)
            out[at : at + len(value)] = value
        elif what == 2:
            out[at:at] = random.randbytes(random.choice((1, 4, 32)))
        elif what == 3:
            del out[at : at + span]
        elif what == 4:
            out[at:at] = out[at : at + span] * random.choice((1, 2, 16))
        elif what == 5:
            del out[at:]
        else:
            out[at : at + span] = random.randbytes(span)
    return bytes(out)


def mutate_text(random: Random, data: bytes) -> bytes:
    """Replace, insert, remove, swap or repeat words and lines; sometimes change bytes as well."""
    lines = data.decode("utf-8", "surrogateescape").split("\n")
    for _ in range(random.choice((1, 1, 2, 4))):
        row = random.randrange(len(lines))
        words = lines[row].split(" ")
        at = random.randrange(len(words))
        what = random.randrange(7)
        if what <= 1:
            words[at] = random.choice(NUMBERS)
        elif what == 2:
            words[at] = random.choice(WORDS)
        elif what == 3:
            words.insert(at, random.choice((*NUMBERS, *WORDS)))
        elif what == 4:
            del words[at]
        lines[row] = " ".join(words)
        if what == 5:
            other = random.randrange(len(lines))
            lines[row], lines[other] = lines[other], lines[row]
        elif what == 6:
            lines[row : row + 1] = [lines[row]] * random.choice((0, 2, 50))
        lines = lines or [""]
    text = "\n".join(lines).encode("utf-8", "surrogateescape")
    return mutate_bytes(random, text) if random.random() < 0.2 else text


def mutate_json(random: Random, data: bytes) -> bytes:
    """Replace, add or remove values anywhere in a JSON document; sometimes change its text."""
    if random.random() < 0.3:
        return mutate_text(random, data)
    if random.random() < 0.02:
        return b"[" * 100_000
    document = json.loads(data)
    for _ in range(random.choice((1, 1, 2, 3))):
        document = _changed(random, document)
    return json.dumps(document).encode("utf-8", "surrogatepass")


def _changed(random: Random, value: Any) -> Any:
    if isinstance(value, dict) and value and random.random() < 0.85:
        key = random.choice(list(value))
        changed = dict(value)
        what = random.random()
        if what < 0.1:
            del changed[key]
        elif what < 0.2:
            changed[random.choice(("x", "", key + " ", "R", "K", "t"))] = random.choice(VALUES)
        else:
            changed[key] = _changed(random, value[key])
        return changed
    if isinstance(value, list) and value and random.random() < 0.7:
        changed_list = list(value)
        at = random.randrange(len(value))
        what = random.random()
        if what < 0.15:
            del changed_list[at]
        elif what < 0.3:
            changed_list.insert(at, random.choice((*VALUES, value[at])))
        else:
            changed_list[at] = _changed(random, value[at])
        return changed_list
    return random.choice(VALUES)


def choose(random: Random, seeds: Sequence[bytes]) -> bytes:
    """One of the seeds; sometimes the start of one with the end of another."""
    if len(seeds) > 1 and random.random() < 0.05:
        first, second = random.choice(seeds), random.choice(seeds)
        return first[: random.randrange(len(first) + 1)] + second[random.randrange(len(second)) :]
    return random.choice(seeds)
