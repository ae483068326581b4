"""Simulate how a sweep over a million pairs scales, from recorded task times.

    python benchmarks/scaling.py record SWEEP CACHE
    python benchmarks/scaling.py overhead
    python benchmarks/scaling.py simulate [--plot docs/images/ablation-scaling.png]

``record`` writes the task times and sizes of a sweep to benchmarks/scaling_times.json; ``overhead``
measures the cost of distributing one task, local and with Dask.

The model is a closed network of three stations. The scheduler serves one worker at a time, for the
recorded cost of a task. The worker then fetches its arrays through a store of limited total
bandwidth, in the order of arrival, and computes for a time drawn from the records. Throughput is
measured after the initial phase.
"""

from __future__ import annotations

import argparse
import heapq
import json
import random
import statistics
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

TIMES = Path(__file__).with_name("scaling_times.json")
WORKERS = [1, 2, 4, 8, 16, 32, 64, 128, 256, 512, 1024, 2048, 4096, 8192]

SHARD = 100  # pairs

Task = tuple[float, float]  # seconds of computing, megabytes through the store


@dataclass(frozen=True)
class Layout:
    """A partition of the sweep into tasks.

    Attributes:
        name: Name in the legend.
        tasks: Function that returns the tasks of a recorded pair.
        scheduler_s: Time of the scheduler per task, seconds.
        store_mb_s: Total bandwidth of the shared store; infinite if every node has its own store.
        pairs_a_task: Number of pairs per task of `tasks`.
    """

    name: str
    tasks: Callable[[dict], list[Task]]
    scheduler_s: float
    store_mb_s: float = float("inf")
    pairs_a_task: int = 1


def as_run(pair: dict) -> list[Task]:
    """Make one task per detection, matching and unit of estimates, with a shared cache."""
    features = [(s, mb) for s, mb in zip(pair["detect"], pair["detect_mb"])]
    matches = [
        (s, 2 * sum(pair["detect_mb"]) / len(pair["detect"]) + mb)
        for s, mb in zip(pair["match"], pair["match_mb"])
    ]
    unit_mb = sum(pair["detect_mb"]) + sum(pair["match_mb"])
    return [*features, *matches, *((s, unit_mb) for s in pair["estimate"])]


def one_task(pair: dict) -> list[Task]:
    """Make one task per pair; its arrays are written to the shared cache once."""
    mb = sum(pair["detect_mb"]) + sum(pair["match_mb"])
    return [(sum(pair["detect"]) + sum(pair["match"]) + sum(pair["estimate"]), mb)]


def one_shard(pair: dict) -> list[Task]:
    """Make one task per SHARD pairs, which one node plans and computes."""
    return [(SHARD * one_task(pair)[0][0], 0.0)]


def throughput(workers: int, layout: Layout, pairs: list[dict], rng: random.Random) -> float:
    """Simulate the throughput of `workers` workers in pairs per hour."""
    tasks = [task for pair in pairs for task in layout.tasks(pair)]
    per_pair = len(tasks) / len(pairs)
    count = max(6 * workers, 20 * len(tasks), 4000)
    rng.shuffle(tasks)
    settle = count // 3
    free_scheduler = free_store = 0.0
    # Events: the times at which workers request a task; stations serve in the order of the events.
    asks = [(rng.uniform(0, 1), k) for k in range(workers)]
    heapq.heapify(asks)
    ends = []
    for n in range(count):
        now, k = heapq.heappop(asks)
        seconds, mb = tasks[n % len(tasks)]
        ready = free_scheduler = max(now, free_scheduler) + layout.scheduler_s
        if layout.store_mb_s != float("inf"):
            ready = free_store = max(ready, free_store) + mb / layout.store_mb_s
        heapq.heappush(asks, (ready + seconds, k))
        ends.append(ready + seconds)
    ends.sort()
    last = count - workers  # later events are affected by the end of the experiment: idle workers
    return (
        (last - settle)
        / (ends[last - 1] - ends[settle - 1])
        / per_pair
        * layout.pairs_a_task
        * 3600
    )


def simulate(args: argparse.Namespace) -> None:
    records = json.loads(TIMES.read_text())
    pairs, rng = records["pairs"], random.Random(0)
    cost = records["overhead_s"]
    task_s, pair_s = cost["dask"], cost["coordinator_pair"]
    each = statistics.mean(len(as_run(p)) for p in pairs)
    layouts = [
        Layout("tasks as now, store of 0.3 GB/s", as_run, task_s + pair_s / each, 300),
        Layout("tasks as now, store of 10 GB/s", as_run, task_s + pair_s / each, 10_000),
        Layout("a pair a task, caches of the nodes", one_task, task_s + pair_s),
        Layout(f"{SHARD} pairs a task, caches of the nodes", one_shard, task_s, pairs_a_task=SHARD),
    ]
    work = statistics.mean(one_task(p)[0][0] for p in pairs)
    mb = statistics.mean(one_task(p)[0][1] for p in pairs)
    print(
        f"{len(pairs)} recorded pairs: {work:.1f} s of one core, {mb:.0f} MB, {each:.0f} tasks "
        "per pair"
    )
    print(
        f"processor time of the coordinator: {1e3 * task_s:.1f} ms per task through Dask, "
        f"{1e3 * pair_s:.1f} ms per pair for its rows\n"
    )
    print(
        "| workers | " + " | ".join(x.name for x in layouts) + " |\n|---:|" + "---:|" * len(layouts)
    )
    curves: dict[str, list[float]] = {x.name: [] for x in layouts}
    for w in WORKERS:
        for x in layouts:
            curves[x.name].append(throughput(w, x, pairs, random.Random(rng.random())))
        print(
            f"| {w:,} | " + " | ".join(f"{curves[x.name][-1]:,.0f}" for x in layouts) + " |",
            flush=True,
        )
    print("\nefficiency of 50 % at about:")
    for x in layouts:
        ideal = [w * 3600 / work for w in WORKERS]
        bent = next((w for w, c, i in zip(WORKERS, curves[x.name], ideal) if c < i / 2), None)
        print(f"  {x.name}: {f'{bent:,} workers' if bent else f'beyond {WORKERS[-1]:,} workers'}")
    if args.plot:
        plot(curves, work, Path(args.plot))


def plot(curves: dict[str, list[float]], work: float, file: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(8, 4.5), layout="constrained")
    for (name, values), style in zip(curves.items(), ("o-", "s-", "^-", "D-")):
        used = [100 * v / (w * 3600 / work) for w, v in zip(WORKERS, values)]
        axes.semilogx(WORKERS, used, style, label=name, markersize=5)
    axes.axhline(50, color="0.8", zorder=0)
    enough = 1e6 / 24 * work / 3600
    axes.axvline(enough, color="0.8", linestyle="--", zorder=0)
    axes.text(enough * 1.08, 104, "a million pairs a day need so many", color="0.4", fontsize=8)
    axes.set(
        xlabel="workers (one core each)",
        ylabel="share of the workers' time that is work, %",
        ylim=(0, 112),
        xticks=WORKERS[::2],
        xticklabels=[f"{w:,}" for w in WORKERS[::2]],
    )
    axes.grid(which="major", alpha=0.25)
    axes.legend(fontsize=8, loc="lower left")
    figure.savefig(file, dpi=110)
    print(file)


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
        # Fusion is counted once for all seeds of a combination.
        spent = [
            sum(e.meta["seconds"]["estimate"] for e in unit)
            + sum({id(j): e.meta["seconds"]["fuse"] for j, e in zip(task.jobs, unit)}.values())
            / plan.seeds
            for task, unit in zip(mine, estimates)
        ]
        found.append(
            {
                "pair": str(plan.pairs[index]),
                "detect": [round(e.meta["seconds"], 4) for e, _ in sides["features"]],
                "detect_mb": [round(mb, 3) for _, mb in sides["features"]],
                "match": [round(e.meta["seconds"], 4) for e, _ in sides["matches"]],
                "match_mb": [round(mb, 3) for _, mb in sides["matches"]],
                "estimate": [round(s, 3) for s in spent],
            }
        )
    old = json.loads(TIMES.read_text()) if TIMES.exists() else {"overhead_s": {}}
    TIMES.write_text(json.dumps(old | {"pairs": found}) + "\n")
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
            engine = DaskEngine(cluster.scheduler_address, Setup(engine_version(), folder))
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
    old = json.loads(TIMES.read_text()) if TIMES.exists() else {"pairs": []}
    TIMES.write_text(json.dumps(old | {"overhead_s": result}) + "\n")
    print({k: f"{1e3 * v:.2f} ms" for k, v in result.items()})


def pairs_of_planes() -> list:
    from sfmkit.datasets import pairs

    return list(pairs("planes", sequences=["blur"], size_wh=(160, 120)))


def coordinator() -> float:
    """Measure planning, scheduling, rows and shards in seconds per pair, with instant workers."""
    from sfmkit.ablation import run
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

    before, run.LocalEngine = run.LocalEngine, Instant  # type: ignore[misc, assignment]
    try:
        with tempfile.TemporaryDirectory() as folder:
            began = time.process_time()
            run.ablate(
                found, ["surf", "orb", "fast-brief", "sift", "akaze"], seeds=3, cache=Path(folder)
            )
            return (time.process_time() - began) / len(found)
    finally:
        run.LocalEngine = before  # type: ignore[misc]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    commands = parser.add_subparsers(required=True)
    one = commands.add_parser("record")
    one.add_argument("sweep", type=Path)
    one.add_argument("cache", type=Path)
    one.set_defaults(run=record)
    commands.add_parser("overhead").set_defaults(run=overhead)
    two = commands.add_parser("simulate")
    two.add_argument("--plot")
    two.set_defaults(run=simulate)
    args = parser.parse_args()
    args.run(args)


if __name__ == "__main__":
    main()
