"""The words of a recording: the story stage by stage and the account, in Markdown."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from .._utils.markdown import table_row
from ..pipeline.account import ALL, HEAD, OperatorAccount, account_cells

if TYPE_CHECKING:
    from ..pipeline.reconstruction import Reconstruction
    from ..types import TwoView


def table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    """Write a Markdown table, its first column to the left, the others to the right."""
    rule = f"| :-- |{' --: |' * (len(head) - 1)}"
    return "\n".join([table_row(head), rule, *map(table_row, rows)])


def account_markdown(account: Mapping[str, OperatorAccount]) -> str:
    """The account as a table."""
    rows = [
        account_cells("**all**" if name == ALL else name, a.as_dict())
        for name, a in account.items()
    ]
    note = (
        "*fused*: correspondences that carry the operator after coincident ones were merged. *alone*: points that no other "
        "operator found. *share*: of the cloud's points. *loss*: fused correspondences that did not become a point."
    )
    return f"{table(HEAD, rows)}\n\n{note}"


def timings_markdown(timings_s: Mapping[str, float]) -> str:
    """Seconds per stage as a table."""
    return table(
        ("stage", "seconds"), [(name, f"{seconds:.2f}") for name, seconds in timings_s.items()]
    )


def verdict_markdown(view: TwoView) -> str:
    """The verdict, its reason and the numbers it rests on."""
    rows = [
        (
            name.replace("_", " "),
            f"{value:,.0f}" if abs(value) >= 100 or float(value).is_integer() else f"{value:.4g}",
        )
        for name, value in view.evidence.items()
    ]
    return f"## {view.verdict.value}\n\n{view.reason}\n\n{table(('evidence', ''), rows)}"


def report_markdown(result: Reconstruction) -> str:
    """Verdict, pose, account and timings on one page."""
    view = result.two_view
    facts = [f"## {view.verdict.value}", view.reason]
    if view.R is not None:
        angle = np.degrees(np.arccos(np.clip((np.trace(view.R.numpy()) - 1) / 2, -1, 1)))
        pose = f"Camera 2 is turned by **{angle:.2f}°** against camera 1"
        if view.t is not None:
            pose += (
                ", translation direction **("
                + ", ".join(f"{v:+.3f}" for v in view.t.tolist())
                + ")**"
            )
        if view.sigma_deg is not None:
            pose += f"; standard deviations {view.sigma_deg[0]:.3f}° and {view.sigma_deg[1]:.3f}°"
        facts.append(pose + ".")
    if result.errors is not None:
        rotation, translation = (result.errors[k] for k in ("rotation_deg", "translation_deg"))
        facts.append(
            f"Against the truth: rotation **{rotation:.3f}°**, translation direction **{translation:.3f}°** off."
        )
    if result.reprojection_rmse_px is not None:
        facts.append(
            f"Reprojection error **{result.reprojection_rmse_px:.3f} px** (root mean square)."
        )
    facts += [
        "## Account",
        account_markdown(result.account),
        "## Time",
        timings_markdown(result.timings_s),
    ]
    if result.warnings:
        facts += ["## Warnings", *[f"- {warning}" for warning in result.warnings]]
    return "\n\n".join(facts)


def story(result: Reconstruction) -> dict[str, str]:
    """What happened at each stage, in a sentence or two."""
    images, account, view = result.images, result.account, result.two_view
    total = account[ALL]
    per = {name: line for name, line in account.items() if name != ALL}
    told = {
        "read": "Two photographs, "
        + " and ".join(f"{w} x {h} pixels" for w, h in (image.size_wh for image in images))
        + f". Focal lengths: {view.camera1.source}, {view.camera2.source}. Nothing is known yet of how the "
        "cameras stand to each other.",
        "detect": "Keypoints in image 1 and 2: "
        + ", ".join(
            f"**{name}** {a.keypoints[0]:,} and {a.keypoints[1]:,}" for name, a in per.items()
        )
        + ".",
        "match": "Each operator matches its own keypoints: "
        + ", ".join(f"**{name}** {a.matches:,}" for name, a in per.items())
        + ". The others have no counterpart.",
        "fuse": f"{total.matches:,} matches of all operators become **{total.initial:,}** correspondences; "
        f"{total.matches - total.initial:,} were the same pair of places found again and were merged.",
        "estimate": f"**{total.inliers:,}** of {total.initial:,} correspondences agree on one geometry. Verdict: "
        f"**{view.verdict.value}**. {view.reason}",
    }
    if view.R is not None:
        told["pose"] = (
            "An essential matrix allows four poses; the one that puts the points in front of both cameras is right."
        )
        if view.t is None:
            told["pose"] = (
                "The camera only turned: the rotation is known, and the translation cannot be recovered."
            )
    if result.cloud is not None:
        told["triangulate"] = (
            f"**{len(result.cloud):,}** points, where the two rays of a correspondence meet. Select one in the 3-D view: "
            "it lights up in both photographs, and the selection panel names its detectors, pixels, residual and angle."
        )
        if result.cloud.covariance is not None:
            told["refine"] = (
                "Pose and points were adjusted together, and each point has an uncertainty: the ellipsoids are stretched "
                "along the rays, where depth is uncertain."
            )
    return {
        stage: f"## {number}. {stage}\n\n{text}"
        for number, (stage, text) in enumerate(told.items())
    }
