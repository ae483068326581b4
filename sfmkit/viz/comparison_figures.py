"""Figure of two registered clouds."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from ..clouds.comparison import Comparison
from .figures import MAX_DOTS, label_side, unit_of

FIRST, SECOND = "#0072B2", "#E69F00"


def comparison_figure(comparison: Comparison) -> Figure:
    """Draw both clouds in two directions, and the distribution of their distances."""
    figure = Figure(figsize=(15, 4.8), layout="constrained")
    axes = figure.subplots(1, 3)
    clouds = (
        (comparison.first.xyz.numpy(), FIRST, "first", comparison.to_second),
        (comparison.second.xyz.numpy(), SECOND, "second", comparison.to_first),
    )
    low, high = np.percentile(clouds[0][0], (1, 99), axis=0)
    pad = 0.05 * (high - low) + 1e-12
    unit = unit_of(comparison.first).strip()
    unit = f" ({unit})" if unit else ""
    for ax, j in zip(axes, (1, 2)):
        for xyz, colour, name, _ in clouds:
            some = xyz[:: -(-len(xyz) // (MAX_DOTS // 2))]
            size = float(np.clip(20_000 / len(some), 0.3, 4))
            ax.scatter(
                some[:, 0], some[:, j], s=size, c=colour, alpha=0.5, linewidths=0, label=name
            )
        ax.set(xlim=(low[0] - pad[0], high[0] + pad[0]), ylim=(low[j] - pad[j], high[j] + pad[j]))
        label_side(ax, comparison.first, j)
    for _, colour, name, distance in clouds:
        share = 100 * np.linspace(0, 1, len(distance))
        axes[2].plot(
            np.sort(np.maximum(distance, 1e-6 * comparison.extent)),
            share,
            color=colour,
            label=f"{name} cloud",
        )
    axes[2].set(
        xscale="log",
        xlabel=f"distance to the nearest point of the other cloud{unit}",
        ylabel="share of the points (%)",
    )
    axes[2].set_title("distance between the clouds")
    axes[2].grid(alpha=0.3)
    axes[2].legend(frameon=False, loc="lower right")
    return figure
