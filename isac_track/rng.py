"""Random streams keyed by name: no draw depends on order, workers or what else runs."""

import hashlib

import numpy as np


def stream(seed: int, *names: str | int) -> np.random.Generator:
    """Return the generator of the stream called `names` under the base seed.

    The names are the stage, then what the draw belongs to: ``stream(0, "sensing",
    "scene", 17)``. They are hashed (SHA-256, with type and length: ``("ab", "c")`` is
    not ``("a", "bc")``) into the spawn key of a `SeedSequence`. ValueError if the seed
    is negative or no name is given.
    """
    if seed < 0:
        raise ValueError(f"the seed must not be negative, got {seed}")
    if not names:
        raise ValueError("a stream needs a name: stream(seed, stage, ...)")
    hashed = hashlib.sha256()
    for name in names:
        # int() folds numpy integers; a bool would silently be 0 or 1 and is not a name.
        text = (f"s{name}" if isinstance(name, str) else f"i{int(name)}").encode()
        hashed.update(len(text).to_bytes(8, "little") + text)
    key = hashed.digest()[:16]
    # The words into which a `SeedSequence` turns the seed and a spawn key: told so, it
    # need not.
    words = max(4, -(-int(seed).bit_length() // 32))
    entropy = np.frombuffer(int(seed).to_bytes(4 * words, "little") + key, dtype="<u4")
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(entropy)))
