"""Seeded damage to files, for tests that readers refuse it in a sentence."""

from __future__ import annotations

import random
import struct
import warnings
from collections.abc import Callable
from pathlib import Path

from physkin_core.file_reading import LONGEST_SENTENCE

NUMBERS = (0, 1, 255, 2**16, 2**28, 2**31 - 1, 2**31, 2**32 - 1)
WORDS = ("nan", "-inf", "1e999", "-1", "9" * 30, "9" * 5000, "x", "", "../../etc/passwd", "\x1b[2J", "\0", "a" * 10**5)
BLOCKS = (1, 4, 16, 256, 4096)  # [bytes]


def damaged(content: bytes, seed: int) -> bytes:
    """The content with some of: bits flipped, its end cut off, blocks repeated, removed or made zero, large numbers in
    the place of others, odd words in the place of others. Equal seeds give equal damage."""
    rng, damage = random.Random(seed), bytearray(content)
    for _ in range(rng.choice((1, 1, 2, 4, 16))):
        at = rng.randrange(len(damage) + 1)
        if rng.random() < 0.3:  # headers are short and say most
            at = min(at, rng.randrange(200))
        block = rng.choice(BLOCKS)
        match rng.randrange(7):
            case 0:
                damage[at : at + 1] = bytes([rng.randrange(256)])
            case 1:
                del damage[at + block :]
            case 2:
                damage[at:at] = damage[at : at + block] * rng.choice((1, 1, 50))
            case 3:
                del damage[at : at + block]
            case 4:
                damage[at : at + block] = bytes(len(damage[at : at + block]))
            case 5:
                damage[at : at + 4] = struct.pack("<I", rng.choice(NUMBERS))
            case 6:
                start = damage.rfind(b" ", 0, at) + 1
                end = damage.find(b" ", at)
                damage[start : end if end >= 0 else at] = rng.choice(WORDS).encode()
    return bytes(damage)


def check_refusals(
    read: Callable[[Path], object],
    whole: Path,
    error: type[ValueError],
    seeds: range,
    *,
    mend: Callable[[bytes], bytes] = bytes,
) -> int:
    """Read damaged copies of a file, beside it: each is read, or refused with `error` in one sentence. Returns how many
    were refused. mend: what someone does who knows the format, such as a digest that fits again."""
    content, refused = whole.read_bytes(), 0
    copy = whole.with_name(f"damaged_{whole.name}")
    for seed in seeds:
        copy.write_bytes(mend(damaged(content, seed)))
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                read(copy)
        except error as told:
            text, refused = str(told), refused + 1
            assert len(text) <= LONGEST_SENTENCE and text.isprintable(), f"seed {seed}: {text!r}"
        except Exception as other:
            raise AssertionError(f"seed {seed} of {whole.name}: {type(other).__name__}: {other}") from other
    return refused
