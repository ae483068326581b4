"""``python -m fuzz``: run many inputs, report the findings, and save the inputs that cause them."""

from __future__ import annotations

import argparse
import collections
import resource
import sys
import time
from dataclasses import replace
from pathlib import Path

from fuzz.engine import Ending, Kind, endings, make_input, seeds_of
from fuzz.kinds import KINDS


def main() -> int:
    """Return 1 if there was a finding."""
    parser = argparse.ArgumentParser(prog="fuzz", description=__doc__)
    parser.add_argument("--inputs", type=int, default=20_000, help="in all")
    parser.add_argument("--seed", type=int, default=0, help="number of the first input of a kind")
    parser.add_argument("--kind", action="append", choices=KINDS, help="only this kind")
    parser.add_argument(
        "--replay",
        metavar="KIND-NUMBER",
        help="one input with its traceback, by number or as a saved file KIND-NUMBER.input",
    )
    parser.add_argument("--out", type=Path, default=Path("out/fuzz"), help="for failing inputs")
    chosen = parser.parse_args()
    if chosen.replay:
        name, _, number = chosen.replay.rpartition("-")
        if Path(chosen.replay).suffix == ".input":
            name, data = Path(name).name, Path(chosen.replay).read_bytes()
            (ending,) = endings(replace(KINDS[name], seeds=lambda _: [data]), range(1))
        else:
            (ending,) = endings(KINDS[name], range(int(number), int(number) + 1))
        print(f"{ending.outcome}\n{ending.details}")
        return int(ending.is_finding)
    kinds = [KINDS[name] for name in chosen.kind or KINDS]
    count = -(-chosen.inputs // len(kinds))
    print(f"{count} inputs of each of {len(kinds)} kinds, from number {chosen.seed}")
    began = time.monotonic()
    found = sum(run(kind, range(chosen.seed, chosen.seed + count), chosen.out) for kind in kinds)
    largest = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024  # kB on Linux
    seconds = time.monotonic() - began
    print(
        f"{count * len(kinds)} inputs, {found} findings, {seconds:.0f} s, "
        f"largest process {largest:.0f} MB"
    )
    return int(found > 0)


def run(kind: Kind, numbers: range, out: Path) -> int:
    """Run inputs of one kind, print a line with the counts, and save the findings."""
    began = time.monotonic()
    outcomes: collections.Counter[str] = collections.Counter()
    places: dict[str, list[Ending]] = {}
    for ending in endings(kind, numbers):
        outcomes[ending.outcome] += 1
        if ending.is_finding:
            save(kind, ending, out)
            places.setdefault(place(ending), []).append(ending)
    counts = ", ".join(f"{n} {outcome}" for outcome, n in sorted(outcomes.items()))
    print(f"{kind.name:<16} {counts} ({time.monotonic() - began:.0f} s)", flush=True)
    for where, these in sorted(places.items(), key=lambda item: -len(item[1])):
        example = f"{kind.name}-{these[0].number}"
        print(f"    {len(these)} x {where}; make fuzz REPLAY={example}", flush=True)
    return sum(map(len, places.values()))


def place(ending: Ending) -> str:
    """The exception and the last line of sfmkit in its traceback, to group findings."""
    lines = ending.details.strip().splitlines() or [""]
    ours = [
        line.strip() for line in lines if "/sfmkit/" in line and line.strip().startswith("File")
    ]
    where = ours[-1].split("/sfmkit/")[-1] if ours else ""
    return f"{ending.outcome}: {lines[-1][:120]} ({where})"


def save(kind: Kind, ending: Ending, out: Path) -> None:
    """Save a failing input with its traceback."""
    out.mkdir(parents=True, exist_ok=True)
    data = make_input(kind, ending.number, seeds_of(kind))
    name = f"{kind.name}-{ending.number}"
    (out / f"{name}.input").write_bytes(data)
    (out / f"{name}.txt").write_text(f"{ending.outcome}\n{ending.details}\n", errors="replace")


if __name__ == "__main__":
    sys.exit(main())
