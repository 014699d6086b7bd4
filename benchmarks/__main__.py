"""Run every benchmark for which the data folder holds scans: ``python -m benchmarks --data DIR``."""

from __future__ import annotations

from argparse import ArgumentParser

from benchmarks import (
    data,
    dbh,
    decoding,
    features,
    fitting,
    grown_truth,
    growth,
    jointboost,
    light,
    lsystem,
    plastic,
    plasticity,
    recognition,
    recovery,
    scanning,
    silhouettes,
    similarity,
    sizes,
    skeleton_truth,
    speed,
    stand,
    texturing,
    vote,
    wood,
)

BENCHMARKS = {
    "wood": wood,
    "skeleton_truth": skeleton_truth,
    "dbh": dbh,
    "sizes": sizes,
    "speed": speed,
    "light": light,
    "growth": growth,
    "plastic": plastic,
    "plasticity": plasticity,
    "similarity": similarity,
    "fitting": fitting,
    "recovery": recovery,
    "scanning": scanning,
    "grown_truth": grown_truth,
    "lsystem": lsystem,
    "decoding": decoding,
    "silhouettes": silhouettes,
    "stand": stand,
    "texturing": texturing,
    "jointboost": jointboost,
    "features": features,
    "vote": vote,
    "recognition": recognition,
}
QUICK_LADDER = (100_000, 1_000_000)


def main() -> None:
    """Command line."""
    parser = ArgumentParser(prog="python -m benchmarks", description=__doc__)
    data.add_arguments(parser)
    parser.add_argument(
        "--skip", default="", help=f"benchmarks to leave out, by commas: {', '.join(BENCHMARKS)}"
    )
    parser.add_argument("--full", action="store_true", help="climb the ladder to 10 million points")
    arguments = parser.parse_args()
    arguments.rungs = list(speed.LADDER if arguments.full else QUICK_LADDER)
    skipped = {name.strip() for name in arguments.skip.split(",")}
    for name, module in BENCHMARKS.items():
        if name in skipped:
            continue
        print(f"## {name}\n\n{(module.__doc__ or '').splitlines()[0]}\n")
        module.run(arguments)
        print(flush=True)


if __name__ == "__main__":
    main()
