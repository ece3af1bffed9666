"""Random streams keyed by name: independent of order and of other computations."""

import hashlib

import numpy as np

__all__ = ["stream"]


def stream(seed: int, *names: str | int) -> np.random.Generator:
    """Return the generator of the stream called `names` under the base seed.

    The names are the stage, then what the draw belongs to: ``stream(0, "sensing",
    "scene", 17)``. They are hashed (SHA-256, with type and length: ``("ab", "c")`` is
    not ``("a", "bc")``) into the spawn key of a `SeedSequence`. ValueError if the seed
    is negative or no name is given.

    References
    ----------
    Spawn keys: numpy, *Parallel random number generation*.

    Examples
    --------
    A stream depends on its names alone, never on what was drawn before:

    >>> from isac_track.rng import stream
    >>> first = stream(0, "sensing", "scene", 17).random()
    >>> first == stream(0, "sensing", "scene", 17).random()
    True
    >>> first == stream(0, "sensing", "scene", 18).random()
    False
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
    # These are the words that a `SeedSequence` makes of a seed and a spawn key; passing
    # them directly saves its conversion.
    words = max(4, -(-int(seed).bit_length() // 32))
    entropy = np.frombuffer(int(seed).to_bytes(4 * words, "little") + key, dtype="<u4")
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(entropy)))
