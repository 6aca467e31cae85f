"""Damage to bytes: a function of a seed, so that every input can be made again."""

from __future__ import annotations

import re
import zlib
from collections.abc import Sequence
from random import Random

_NUMBERS = [0, 1, 2, 127, 128, 255, 256, 32767, 65535, 2**24, 2**31 - 1, 2**31, 2**32 - 1, 2**40, 2**63 - 1, 2**64]
_TEXTS = [
    b"nan",
    b"-inf",
    b"1e999",
    b"-1",
    b"0",
    b"",
    b"null",
    b"{}",
    b"[" * 300,
    b"9" * 5000,
    b"\0",
    b"\xff\xfe",
    b"\n",
]
_DIGITS = re.compile(rb"-?\d+(?:\.\d+)?")


def mutated(seeds: Sequence[bytes], seed: str) -> bytes:
    """One of the seeds with one to eight random changes."""
    random = Random(seed)
    data = bytearray(random.choice(seeds))
    for _ in range(min(8, 1 + int(random.expovariate(0.6)))):
        random.choice(_CHANGES)(data, random, seeds)
    if random.random() < 0.7:
        _repair_png(data)
    return bytes(data)


def _place(data: bytearray, random: Random) -> int:
    """Anywhere, but more often near the beginning, where the headers are."""
    end = len(data) if random.random() < 0.5 else min(len(data), 128)
    return random.randrange(end + 1)


def _flip(data: bytearray, random: Random, seeds: Sequence[bytes]) -> None:
    for _ in range(random.choice((1, 1, 1, 4, 16))):
        if data:
            data[min(_place(data, random), len(data) - 1)] ^= 1 << random.randrange(8)


def _bytes(data: bytearray, random: Random, seeds: Sequence[bytes]) -> None:
    place = _place(data, random)
    data[place : place + random.choice((1, 2, 4, 8))] = random.randbytes(random.choice((1, 2, 4, 8)))


def _number(data: bytearray, random: Random, seeds: Sequence[bytes]) -> None:
    """A number of 1, 2, 4 or 8 bytes that means much or little."""
    place, size = _place(data, random), random.choice((1, 2, 4, 8))
    value = random.choice(_NUMBERS) % 2 ** (8 * size)
    data[place : place + size] = value.to_bytes(size, random.choice(("little", "big")))


def _text(data: bytearray, random: Random, seeds: Sequence[bytes]) -> None:
    """A number in digits becomes another, or something else."""
    found = list(_DIGITS.finditer(data[:4000]))
    replacement = random.choice([*_TEXTS, *(str(number).encode() for number in _NUMBERS)])
    place = _place(data, random)
    data[slice(*random.choice(found).span()) if found else slice(place, place)] = replacement


def _cut(data: bytearray, random: Random, seeds: Sequence[bytes]) -> None:
    del data[_place(data, random) :]


def _remove(data: bytearray, random: Random, seeds: Sequence[bytes]) -> None:
    place = _place(data, random)
    del data[place : place + random.randrange(1, 64)]


def _repeat(data: bytearray, random: Random, seeds: Sequence[bytes]) -> None:
    place = _place(data, random)
    piece = data[place : place + random.randrange(1, 64)]
    data[place:place] = piece * random.choice((1, 2, 2, 50))


def _splice(data: bytearray, random: Random, seeds: Sequence[bytes]) -> None:
    """The beginning of this and the end of another."""
    other = random.choice(seeds)
    place = _place(data, random)
    data[place:] = other[min(place, len(other)) :]


_CHANGES = [_flip, _flip, _bytes, _number, _number, _text, _cut, _remove, _repeat, _splice]


def _repair_png(data: bytearray) -> None:
    """Puts the checksums right, so that the damage reaches what is behind them."""
    if data[:8] != b"\x89PNG\r\n\x1a\n":
        return
    place = 8
    while place + 12 <= len(data):
        end = place + 8 + int.from_bytes(data[place : place + 4], "big")
        if end + 4 > len(data):
            return
        data[end : end + 4] = zlib.crc32(data[place + 4 : end]).to_bytes(4, "big")
        place = end + 4
