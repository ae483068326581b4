"""Simulate how a sweep over a million pairs scales, from measured costs.

    python benchmarks/scaling.py throughput [--plot docs/images/ablation-scaling.png]
    python benchmarks/scaling.py million

Both read benchmarks/scaling_times.json, which benchmarks/scaling_measure.py writes.

``throughput`` is a closed network of three stations. The scheduler serves one worker at a time, for
the measured cost of a task. The worker then fetches its bytes through a store of limited total
bandwidth, in the order of arrival, and computes for a time drawn from the records. Throughput is
measured after the initial phase. ``million`` simulates the shards of 10^6 pairs from the first to
the last, the end included, in which workers are idle.
"""

from __future__ import annotations

import argparse
import heapq
import json
import random
import statistics
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

TIMES = Path(__file__).with_name("scaling_times.json")
WORKERS = [1, 2, 4, 8, 16, 32, 64, 128, 256, 512, 1024, 2048, 4096, 8192]
SHARD = 100  # pairs
PAIRS = 1_000_000
SLOW, FAST = 300, 10_000  # MB/s of a shared store: one NFS server, and a parallel file system

Task = tuple[float, float]  # seconds of computing, megabytes through the store


@dataclass(frozen=True)
class Layout:
    """A way to run the sweep.

    Attributes:
        name: For the legend.
        tasks: Recorded pair -> its tasks.
        scheduler_s: Seconds of the scheduler per task.
        store_mb_s: Total bandwidth of the shared store.
        pairs_a_task: Recorded pairs that `tasks` stands for.
    """

    name: str
    tasks: Callable[[dict], list[Task]]
    scheduler_s: float
    store_mb_s: float
    pairs_a_task: int = 1


def as_run(pair: dict) -> list[Task]:
    """Make one task per detection, matching and unit of estimates, with a shared cache.

    Each detection reads its image.
    """
    features = [
        (s, mb + pair["image_mb"][k % 2])
        for k, (s, mb) in enumerate(zip(pair["detect"], pair["detect_mb"]))
    ]
    matches = [
        (s, 2 * sum(pair["detect_mb"]) / len(pair["detect"]) + mb)
        for s, mb in zip(pair["match"], pair["match_mb"])
    ]
    unit_mb = sum(pair["detect_mb"]) + sum(pair["match_mb"])
    return [*features, *matches, *((s, unit_mb) for s in pair["estimate"])]


def one_task(pair: dict) -> list[Task]:
    """Make one task per pair; the cache is on the node, and the images are in the shared store."""
    seconds = sum(pair["detect"]) + sum(pair["match"]) + sum(pair["estimate"])
    return [(seconds, sum(pair["image_mb"]))]


def shard_of(fixed_s: float) -> Callable[[dict], list[Task]]:
    """Make one task per SHARD pairs, which one node plans and computes."""

    def one_shard(pair: dict) -> list[Task]:
        ((seconds, mb),) = one_task(pair)
        return [(fixed_s + SHARD * seconds, SHARD * mb)]

    return one_shard


def fixed_seconds(records: dict) -> float:
    """Processor seconds of a measured shard beyond its tasks."""
    measured = records["shards"]["measured"]
    return statistics.median(s["processor_s"] - s["tasks_s"] for s in measured)


def simulate_throughput(workers: int, layout: Layout, pairs: list[dict], rng: random.Random):
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
        ready = free_store = max(ready, free_store) + mb / layout.store_mb_s
        heapq.heappush(asks, (ready + seconds, k))
        ends.append(ready + seconds)
    ends.sort()
    last = count - workers  # later events are affected by the end of the experiment: idle workers
    rate = (last - settle) / (ends[last - 1] - ends[settle - 1])
    return rate / per_pair * layout.pairs_a_task * 3600


def throughput(args: argparse.Namespace) -> None:
    """Print the throughput of every layout, and draw it."""
    records = json.loads(TIMES.read_text())
    pairs, rng = records["pairs"], random.Random(0)
    cost, fixed = records["overhead_s"], fixed_seconds(records)
    task_s, pair_s = cost["dask"], cost["coordinator_pair"]
    each = statistics.mean(len(as_run(p)) for p in pairs)
    now_s, shard = task_s + pair_s / each, shard_of(fixed)
    layouts = [
        Layout("tasks as now, store of 0.3 GB/s", as_run, now_s, SLOW),
        Layout("tasks as now, store of 10 GB/s", as_run, now_s, FAST),
        Layout("one task per pair, images from 0.3 GB/s", one_task, task_s + pair_s, SLOW),
        Layout(f"shards of {SHARD} pairs, images from 0.3 GB/s", shard, 0.0, SLOW, SHARD),
        Layout(f"shards of {SHARD} pairs, images from 10 GB/s", shard, 0.0, FAST, SHARD),
    ]
    work = statistics.mean(one_task(p)[0][0] for p in pairs)
    images = statistics.mean(sum(p["image_mb"]) for p in pairs)
    arrays = statistics.mean(sum(p["detect_mb"]) + sum(p["match_mb"]) for p in pairs)
    print(
        f"{len(pairs)} recorded pairs: {work:.1f} s of one core, images {images:.1f} MB, arrays "
        f"{arrays:.0f} MB, {each:.0f} tasks per pair; {fixed:.1f} s per shard"
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
            curves[x.name].append(simulate_throughput(w, x, pairs, random.Random(rng.random())))
        print(
            f"| {w:,} | " + " | ".join(f"{curves[x.name][-1]:,.0f}" for x in layouts) + " |",
            flush=True,
        )
    print("\nhalf of the workers' time is lost from about:")
    for x in layouts:
        ideal = [w * 3600 / work for w in WORKERS]
        bent = next((w for w, c, i in zip(WORKERS, curves[x.name], ideal) if c < i / 2), None)
        print(f"  {x.name}: {f'{bent:,} workers' if bent else f'beyond {WORKERS[-1]:,} workers'}")
    if args.plot:
        plot(curves, work, Path(args.plot))


def run_shards(
    workers: int, shard: int, pairs: list[dict], fixed_s: float, store_mb_s: float
) -> tuple[float, float]:
    """Simulate all shards of a million pairs.

    Returns:
        Seconds until the last shard is done, and the share of the workers' time that is spent on
        tasks.
    """
    rng = np.random.default_rng(0)
    seconds = np.array([one_task(p)[0][0] for p in pairs])
    mb = np.array([sum(p["image_mb"]) for p in pairs])
    drawn = rng.integers(0, len(pairs), (PAIRS // shard, shard))
    work, megabytes = seconds[drawn].sum(1), mb[drawn].sum(1)
    free = [0.0] * workers
    free_store = end = 0.0
    for spent, fetched in zip(work.tolist(), megabytes.tolist()):
        ready = free_store = max(heapq.heappop(free), free_store) + fetched / store_mb_s
        done = ready + fixed_s + spent
        heapq.heappush(free, done)
        end = max(end, done)
    return end, float(work.sum()) / (workers * end)


def million(args: argparse.Namespace) -> None:
    """Print the duration of 10^6 pairs for numbers of workers, sizes of shards and stores."""
    records = json.loads(TIMES.read_text())
    fixed = fixed_seconds(records)
    cases = [(100, SLOW), (100, FAST), (20, FAST)]
    heads = [f"{n} pairs, {store / 1000:g} GB/s" for n, store in cases]
    print("| workers | shards per worker | " + " | ".join(heads) + " |")
    print("|---:|---:|" + "---:|" * len(cases))
    for workers in (256, 1024, 2048, 4096, 8192):
        cells = []
        for shard, store in cases:
            seconds, used = run_shards(workers, shard, records["pairs"], fixed, store)
            cells.append(f"{seconds / 3600:.1f} h, {used:.0%}")
        waves = PAIRS / 100 / workers
        print(f"| {workers:,} | {waves:.1f} | " + " | ".join(cells) + " |", flush=True)


def plot(curves: dict[str, list[float]], work: float, file: Path) -> None:
    """Draw the share of the workers' time that is work."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(8, 4.5), layout="constrained")
    for (name, values), style in zip(curves.items(), ("o-", "s-", "^-", "D-", "v-")):
        used = [100 * v / (w * 3600 / work) for w, v in zip(WORKERS, values)]
        axes.semilogx(WORKERS, used, style, label=name, markersize=5)
    axes.axhline(50, color="0.8", zorder=0)
    enough = PAIRS / 24 * work / 3600
    axes.axvline(enough, color="0.8", linestyle="--", zorder=0)
    axes.text(enough * 1.08, 104, "a million pairs in a day", color="0.4", fontsize=8)
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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    commands = parser.add_subparsers(required=True)
    one = commands.add_parser("throughput")
    one.add_argument("--plot")
    one.set_defaults(run=throughput)
    commands.add_parser("million").set_defaults(run=million)
    args = parser.parse_args()
    args.run(args)


if __name__ == "__main__":
    main()
