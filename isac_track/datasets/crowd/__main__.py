"""``python -m isac_track.datasets.crowd``: simulate both sessions of the crowd anew."""

from argparse import ArgumentParser
from dataclasses import asdict
from pathlib import Path

from isac_track.datasets.crowd import (
    BUNDLED_SEED,
    FILES,
    CrowdSettings,
    generate,
    write_npz,
)


def main(arguments: list[str] | None = None) -> int:
    """Write both sessions of the crowd to a folder."""
    parser = ArgumentParser(
        prog="python -m isac_track.datasets.crowd", description=main.__doc__
    )
    parser.add_argument("--out", type=Path, required=True, metavar="DIR")
    parser.add_argument("--seed", type=int, default=BUNDLED_SEED)
    parser.add_argument("--trait-strength", type=float, default=1.0, metavar="S")
    options = parser.parse_args(arguments)
    settings = CrowdSettings(trait_strength=options.trait_strength)
    options.out.mkdir(parents=True, exist_ok=True)
    for session, name in FILES.items():
        tracks = generate(settings, seed=options.seed, session=session)
        about = {"settings": asdict(settings), "seed": options.seed, "session": session}
        write_npz(options.out / name, tracks, frame_s=settings.frame_s, about=about)
        print(f"{options.out / name}: {len(tracks)} tracks")  # noqa: T201 - the command's output
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
