"""Random changes of bytes, of the values in YAML and JSON, and of names."""

import random
from typing import Any

_TOKENS = (
    b"\x00",
    b"\xff",
    b"\n",
    b"-",
    b"0",
    b"9" * 30,
    b"1e309",
    b"nan",
    b"{",
    b"[" * 200,
    b"../",
    b"*a",
    b"&a ",
    b"'",
)
_VALUES: tuple[Any, ...] = (
    *(None, True, "", "nan", "../../x", "x" * 5000, "\u0000", "é\u202e", [], {}, [[]], {"a": {"b": [1]}}),
    *(0, -1, 1, 3, 10**6, 10**30, -(10**30), 2**63, 0.5, 1e-300, 1e300, -1e300, float("inf"), float("nan")),
)
_NAMES = (
    *(
        "..",
        ".",
        "/",
        "a/b",
        "../a",
        "data",
        "artifacts",
        "comparison",
        "mlflow.db",
        "?",
        "%20",
        "a?b",
        "#",
        "a b",
        " a",
    ),
    *(
        "a ",
        "o'neill",
        '"',
        "a" * 300,
        "é",
        "名",
        "\\",
        "$x",
        "${seed}",
        "~",
        "*",
        "-",
        "--help",
        "a.",
        ".a",
        "a\tb",
        "a\nb",
    ),
    *(
        "NUL",
        "aux",
        "runs",
        "{a}",
        "[a]",
        "a,b",
        "a=b",
        "a:b",
        "@",
        "0",
        "null",
        "true",
        "1e5",
        "<a>",
        "a|b",
        "&",
        ";ls",
    ),
)


def bytes_of(rng: random.Random, content: bytes) -> bytes:
    """Bits flipped, bytes taken out, put in, doubled or cut off, one to eight times."""
    changed = bytearray(content)
    for _ in range(rng.randint(1, 8)):
        at = rng.randrange(len(changed) + 1)
        to = min(len(changed), at + rng.choice((1, 4, 100)))
        how = rng.randrange(6)
        if how == 0 and at < len(changed):
            changed[at] ^= 1 << rng.randrange(8)
        elif how == 1:
            del changed[at:to]
        elif how == 2:
            changed[at:at] = rng.choice(_TOKENS)
        elif how == 3:
            changed[at:at] = changed[at:to]
        elif how == 4:
            changed[at:to] = rng.randbytes(to - at)
        elif rng.random() < 0.2:
            del changed[at:]
    return bytes(changed)


def tree_of(rng: random.Random, tree: Any) -> Any:
    """One value, somewhere, replaced or removed; a key of a mapping may be another."""
    if isinstance(tree, dict) and tree and rng.random() < 0.9:
        key = rng.choice(sorted(tree, key=str))
        how = rng.random()
        if how < 0.1:
            return {k: v for k, v in tree.items() if k != key}
        if how < 0.15:
            return {**{k: v for k, v in tree.items() if k != key}, f"{key}x": tree[key]}
        return {**tree, key: tree_of(rng, tree[key])}
    if isinstance(tree, list) and tree and rng.random() < 0.7:
        at = rng.randrange(len(tree))
        return [*tree[:at], tree_of(rng, tree[at]), *tree[at + 1 :]]
    return rng.choice(_VALUES)


def name(rng: random.Random) -> str:
    """A name that is odd in some way."""
    if rng.random() < 0.5:
        return rng.choice(_NAMES)
    parts = [rng.choice((rng.choice(_NAMES), chr(rng.randrange(1, 0x2FF)), "a")) for _ in range(rng.randint(1, 4))]
    return "".join(parts).replace("\ud800", "")
