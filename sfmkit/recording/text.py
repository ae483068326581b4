"""Texts of a recording in Markdown: a description of each stage, and per-operator statistics."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from ..pipeline.account import ALL, HEAD, OperatorAccount, account_cells
from .stream import STAGES

if TYPE_CHECKING:
    from torch import Tensor

    from ..pipeline.reconstruction import Reconstruction
    from ..types import TwoView


def table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    """Format a Markdown table, the first column aligned left, the others right."""
    lines = [head, (":--", *["--:"] * (len(head) - 1)), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def account_markdown(account: Mapping[str, OperatorAccount]) -> str:
    """Format the per-operator statistics as a table."""
    rows = [
        account_cells("**all**" if name == ALL else name, a.as_dict())
        for name, a in account.items()
    ]
    note = (
        "*fused*: correspondences of the operator after duplicates were merged. *alone*: points "
        "that no other operator found. *share*: of the points of the cloud. *loss*: fused "
        "correspondences that did not become a point."
    )
    return f"{table(HEAD, rows)}\n\n{note}"


def timings_markdown(timings_s: Mapping[str, float]) -> str:
    """Format the seconds of each stage as a table."""
    return table(
        ("stage", "seconds"),
        [
            (f"{STAGES.index(name)} {name}" if name in STAGES else name, f"{seconds:.2f}")
            for name, seconds in timings_s.items()
        ],
    )


def verdict_markdown(view: TwoView) -> str:
    """Format the verdict, its reason and the evidence."""
    rows = [
        (
            name.replace("_", " "),
            f"{value:,.0f}" if abs(value) >= 100 or float(value).is_integer() else f"{value:.4g}",
        )
        for name, value in view.evidence.items()
    ]
    parts = [f"## {view.verdict.value}", view.reason, *_alternatives(view)]
    parts.append(table(("evidence", ""), rows))
    if view.witnesses:
        tails = [(name, f"10^{tail:,.0f}") for name, tail in view.witnesses.items()]
        head = ("operator, held out", "chance of its agreement with the others' pose")
        parts.append(table(head, tails))
    return "\n\n".join(parts)


def _alternatives(view: TwoView) -> list[str]:
    """Other motions that explain the matches, one sentence each."""
    return [f"Another motion explains the matches: {_motion(R, t)}." for R, t in view.alternatives]


def _motion(R: Tensor, t: Tensor | None) -> str:
    angle = np.degrees(np.arccos(np.clip((np.trace(R.numpy()) - 1) / 2, -1, 1)))
    text = f"rotation **{angle:.2f}°**"
    if t is not None:
        direction = ", ".join(f"{v:+.3f}" for v in t.tolist())
        text += f", translation direction **({direction})**"
    return text


def report_markdown(result: Reconstruction) -> str:
    """Format verdict, pose, per-operator statistics and timings as one page."""
    view = result.two_view
    facts = [f"## {view.verdict.value}", view.reason]
    if view.R is not None:
        pose = f"From camera 1 to camera 2: {_motion(view.R, view.t)}"
        if view.sigma_deg is not None:
            pose += f"; standard deviations {view.sigma_deg[0]:.3f}° and {view.sigma_deg[1]:.3f}°"
        facts += [pose + ".", *_alternatives(view)]
    if result.errors is not None:
        rotation, translation = (result.errors[k] for k in ("rotation_deg", "translation_deg"))
        facts.append(
            f"Errors with respect to the true pose: rotation **{rotation:.3f}°**, "
            f"translation direction **{translation:.3f}°**."
        )
    if result.reprojection_rmse_px is not None:
        facts.append(
            f"Reprojection error **{result.reprojection_rmse_px:.3f} px** (root mean square)."
        )
    facts += [
        "## Per-operator statistics",
        account_markdown(result.account),
        "## Time",
        timings_markdown(result.timings_s),
    ]
    if result.warnings:
        facts += ["## Warnings", *[f"- {warning}" for warning in result.warnings]]
    return "\n\n".join(facts)


def story(result: Reconstruction) -> dict[str, str]:
    """Describe what happened at each stage, in one to three sentences."""
    account, view, cloud = result.account, result.two_view, result.cloud
    total = account[ALL]
    per = {name: line for name, line in account.items() if name != ALL}
    sizes = " and ".join(f"{w} x {h} pixels" for w, h in (i.size_wh for i in result.images))
    keypoints = ", ".join(
        f"**{name}** {a.keypoints[0]:,} and {a.keypoints[1]:,}" for name, a in per.items()
    )
    matches = ", ".join(f"**{name}** {a.matches:,}" for name, a in per.items())
    described = {
        "read": f"Two photographs, {sizes}. Focal lengths: {view.camera1.source}, "
        f"{view.camera2.source}. The relative pose of the cameras is not known yet.",
        "detect": f"Keypoints in image 1 and 2: {keypoints}.",
        "match": f"Matches within each operator: {matches}.",
        "fuse": f"{total.matches:,} matches of all operators become **{total.initial:,}** "
        f"correspondences; {total.matches - total.initial:,} duplicates were merged.",
        "estimate": f"**{total.inliers:,}** of {total.initial:,} correspondences agree with one "
        f"geometry. Verdict: **{view.verdict.value}**. {view.reason}",
    }
    if view.R is not None and view.t is None:
        described["pose"] = "The camera only rotated. The translation cannot be determined."
    elif view.R is not None:
        described["pose"] = (
            "An essential matrix allows four poses. In the right one the points are in front of "
            "both cameras."
        )
    if view.sigma_deg is not None:
        described["refine"] = (
            "Pose and points were adjusted together. The standard deviations of the pose are "
            f"{view.sigma_deg[0]:.3f}° (rotation) and {view.sigma_deg[1]:.3f}° (translation)."
        )
    if cloud is not None:
        described["triangulate"] = (
            f"**{len(cloud):,}** points, where the two rays of a correspondence meet. Select a "
            "point in the 3-D view to see its pixels in both photographs and its data on the right."
        )
    if cloud is not None and cloud.covariance is not None:
        described["triangulate"] += (
            " The ellipsoids of uncertainty are long along the rays, because depth is least "
            "certain."
        )
    return {
        stage: f"## {STAGES.index(stage)}. {stage}\n\n{words}" for stage, words in described.items()
    }
