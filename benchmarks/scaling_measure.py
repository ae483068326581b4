"""Measure what the model of benchmarks/scaling.py starts from.

    python benchmarks/scaling_measure.py record SWEEP CACHE
    python benchmarks/scaling_measure.py overhead
    python benchmarks/scaling_measure.py shards [--data oxford:graf --shards 5]

``record`` writes the task times and sizes of a sweep, ``overhead`` the cost of distributing one
task, ``shards`` the cost of `sfmkit ablate --shard` with an empty cache per shard. The results are
in benchmarks/scaling_times.json.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

TIMES = Path(__file__).with_name("scaling_times.json")


def update(**parts: object) -> None:
    """Replace parts of the file of measurements."""
    old = json.loads(TIMES.read_text()) if TIMES.exists() else {"pairs": [], "overhead_s": {}}
    TIMES.write_text(json.dumps(old | parts) + "\n")


def record(args: argparse.Namespace) -> None:
    """Record task times (processor time) and sizes of a sweep, finished or not, from its cache."""
    from sfmkit.ablation.cache import Cache
    from sfmkit.ablation.folder import read_sweep
    from sfmkit.ablation.plan import make_plan
    from sfmkit.ablation.tasks import EstimateTask

    cache, sweep = Cache(args.cache), read_sweep(args.sweep)
    names = ",".join(dict.fromkeys(p["dataset"] for p in sweep["pairs"]))
    plan = make_plan(
        names,
        sweep["operators"],
        combos=["/".join(c) for c in sweep["combinations"]],
        seeds=sweep["seeds"],
    )
    units: dict[int, list[EstimateTask]] = {}
    for unit in plan.units:
        units.setdefault(unit.pair, []).append(unit)
    found = []
    for index, mine in units.items():
        matches = {m.key: m for unit in mine for m in unit.needs}
        detections = {d.key: d for m in matches.values() for d in m.needs}
        estimates = [[cache.get("estimates", job.key) for job in unit.jobs] for unit in mine]
        if not all(entry is not None for unit in estimates for entry in unit):
            continue
        sides = {
            kind: [
                (cache.get(kind, key), len(cache.get_bytes(kind, key) or b"") / 1e6) for key in keys
            ]
            for kind, keys in (("features", detections), ("matches", matches))
        }
        # Fusing is counted once for all seeds of a combination.
        spent = [
            sum(e.meta["seconds"]["estimate"] for e in unit)
            + sum({id(j): e.meta["seconds"]["fuse"] for j, e in zip(task.jobs, unit)}.values())
            / plan.seeds
            for task, unit in zip(mine, estimates)
        ]
        found.append(
            {
                "pair": str(plan.pairs[index]),
                "image_mb": [
                    round(os.path.getsize(image.path) / 1e6, 3)
                    for image in plan.pairs[index].images or ()
                ],
                "detect": [round(e.meta["seconds"], 4) for e, _ in sides["features"]],
                "detect_mb": [round(mb, 3) for _, mb in sides["features"]],
                "match": [round(e.meta["seconds"], 4) for e, _ in sides["matches"]],
                "match_mb": [round(mb, 3) for _, mb in sides["matches"]],
                "estimate": [round(s, 3) for s in spent],
            }
        )
    update(pairs=found)
    print(f"{len(found)} pairs in {TIMES}")


def overhead(args: argparse.Namespace) -> None:
    """Measure the processor time of the coordinator.

    It is measured per task through Dask, and per pair for planning, rows and shards.
    """
    from distributed import LocalCluster

    from sfmkit.ablation.cluster import DaskEngine
    from sfmkit.ablation.plan import make_plan
    from sfmkit.ablation.version import engine_version
    from sfmkit.ablation.worker import Parcel, Setup

    with tempfile.TemporaryDirectory() as folder:
        pair = next(iter(pairs_of_planes()))
        task = next(iter(make_plan([pair], ["orb"], images=Path(folder)).detections.values()))
        # The scheduler runs in this process, so its time is included. After the first run the task
        # is in the cache.
        with LocalCluster(
            n_workers=1, threads_per_worker=1, processes=True, dashboard_address=None
        ) as cluster:
            engine = DaskEngine(cluster.scheduler_address, Setup(engine_version(), folder), 60.0)
            for _ in range(20):
                engine.submit(task, Parcel())
                engine.next()
            n, began = 500, time.process_time()
            for _ in range(n):
                engine.submit(task, Parcel())
                engine.next()
            spent = (time.process_time() - began) / n
            engine.close()
    result = {"dask": round(spent, 6), "coordinator_pair": round(coordinator(), 6)}
    update(overhead_s=result)
    print({k: f"{1e3 * v:.2f} ms" for k, v in result.items()})


def pairs_of_planes() -> list:
    from sfmkit.datasets import pairs

    return list(pairs("planes", sequences=["blur"], size_wh=(160, 120)))


def coordinator() -> float:
    """Measure planning, scheduling, rows and shards in seconds per pair, with instant workers."""
    from sfmkit.ablation import engine_choice, run
    from sfmkit.ablation.tasks import EstimateTask
    from sfmkit.ablation.worker import Outcome

    found = pairs_of_planes()
    estimate = {
        "keypoints": [9, 9],
        "matches": 9,
        "correspondences": 9,
        "inliers": 9,
        "guided": 9,
        "verdict": "planar",
        "reason": "",
        "H": [1.0, 0, 0, 0, 1, 0, 0, 0, 1],
        "R": None,
        "t": None,
        "peak_mb": 1.0,
        "versions": {},
        "machine": "",
        "seconds": {"detect": 1.0, "match": 1.0, "fuse": 1.0, "estimate": 1.0},
    }

    class Instant:
        shares_files, slots = True, 2

        def __init__(self, *args: object):
            self.tasks: list = []

        def submit(self, task: object, parcel: object) -> None:
            self.tasks.append(task)

        def next(self) -> tuple:
            task = self.tasks.pop()
            jobs = task.jobs if isinstance(task, EstimateTask) else ()
            return task, Outcome("done", estimates={job.key: estimate for job in jobs})

        def close(self) -> None: ...

    before, engine_choice.LocalEngine = engine_choice.LocalEngine, Instant  # type: ignore[misc, assignment]
    try:
        with tempfile.TemporaryDirectory() as folder:
            began = time.process_time()
            run.ablate(
                found, ["surf", "orb", "fast-brief", "sift", "akaze"], seeds=3, cache=Path(folder)
            )
            return (time.process_time() - began) / len(found)
    finally:
        engine_choice.LocalEngine = before  # type: ignore[misc]


def shards(args: argparse.Namespace) -> None:
    """Run a small sweep in shards and measure each of them.

    Processor seconds of the command and its worker; the seconds of the tasks are those of the
    rows, so the rest is the start of two processes, the plan, the rows and the table.
    """
    found = []
    for number in range(1, args.shards + 1):
        with tempfile.TemporaryDirectory() as work:
            out, cache = Path(work) / "out", Path(work) / "cache"
            command = [sys.executable, "-m", "sfmkit.cli", "ablate", "--data", args.data]
            command += ["--shard", f"{number}/{args.shards}", "--workers", "1", "--quiet"]
            command += ["--out", str(out), "--cache", str(cache)]
            began, before = time.perf_counter(), os.times()
            subprocess.run(command, check=True)
            wall, after = time.perf_counter() - began, os.times()
            found.append(
                shard_figures(out, cache)
                | {
                    "wall_s": round(wall, 2),
                    "processor_s": round(
                        after.children_user
                        + after.children_system
                        - before.children_user
                        - before.children_system,
                        2,
                    ),
                }
            )
            print(found[-1], flush=True)
    update(shards={"data": args.data, "measured": found})


def shard_figures(out: Path, cache: Path) -> dict[str, float]:
    """Pairs, processor seconds of the tasks, and megabytes of the images, the cache and `out`."""
    from sfmkit.ablation import read_sweep, read_table

    images = {i["path"] for pair in read_sweep(out)["pairs"] for i in pair["images"]}
    stages: dict[tuple, float] = {}
    for row in read_table(out):
        # Estimates are made per row; detections and matchings are shared by the rows of a pair.
        stages[(row["pair"], row["combination"], row["seed"])] = row["seconds_estimate"]
        if row["n_operators"] == 1:
            stages[(row["pair"], row["combination"], "match")] = row["seconds_match"]
            stages[(row["pair"], row["combination"], "detect")] = row["seconds_detect"]

    def megabytes(folder: Path) -> float:
        return round(sum(f.stat().st_size for f in folder.rglob("*") if f.is_file()) / 1e6, 3)

    return {
        "pairs": len(read_sweep(out)["pairs"]),
        "tasks_s": round(sum(stages.values()), 2),
        "image_mb": round(sum(map(os.path.getsize, images)) / 1e6, 3),
        "cache_mb": megabytes(cache),
        "out_mb": megabytes(out),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    commands = parser.add_subparsers(required=True)
    one = commands.add_parser("record")
    one.add_argument("sweep", type=Path)
    one.add_argument("cache", type=Path)
    one.set_defaults(run=record)
    commands.add_parser("overhead").set_defaults(run=overhead)
    two = commands.add_parser("shards")
    two.add_argument("--data", default="oxford:graf")
    two.add_argument("--shards", type=int, default=5)
    two.set_defaults(run=shards)
    args = parser.parse_args()
    args.run(args)


if __name__ == "__main__":
    main()
