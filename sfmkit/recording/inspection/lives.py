"""The life of a keypoint or match from its detection to a point of the cloud, or to its rejection.

A life is a list of steps in words. The templates in :data:`WORDS` are filled by Python's
``str.format`` here and by JavaScript in the page of ``sfmkit page``, so that both say the same.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..read import RecordingError
from ..trace import BEHIND, INLIER, NO_GEOMETRY, OFF_HOMOGRAPHY, OFF_LINE, POINT
from ._words import facts
from .tables import Tables

#: Templates. Only the format specifications ``,``, ``.Nf`` and ``,.Nf`` occur.
WORDS = {
    "keypoint": "{operator} keypoint {keypoint:,} of image {image}",
    "match": "match {match:,} of {total:,}",
    "point": "point {point:,} of {total:,}",
    "detected": "by {operator} in image {image}, keypoint {keypoint:,}, at ({x:.1f}, {y:.1f}); "
    "diameter {scale:.1f} px, orientation {angle:.0f} deg, response {response:,.2f}",
    "matched": "with keypoint {partner:,} of image {other} at ({x:.1f}, {y:.1f}); "
    "descriptor distance {distance:.2f}",
    "ratio": ", {ratio:.2f} of the second best",
    "unmatched": "ended here: no match; {rule}",
    "kept": "the position of {kept} was kept; found by {operators}",
    "merged": "merged into match {match:,} of {kept}, a duplicate within {radius:.1f} px",
    "joined": "{operator} keypoints {keypoint1:,} at ({x1:.1f}, {y1:.1f}) and {keypoint2:,} at "
    "({x2:.1f}, {y2:.1f}) were merged into it",
    "inlier": "inlier, {distance:.2f} px from the geometry",
    "outlier": "ended here: {reason}, {distance:.2f} px from the geometry; {why}",
    "no geometry": "ended here: {reason}; {why}",
    "triangulated": "point {point:,} at ({x:.3f}, {y:.3f}, {z:.3f}) baselines",
    "no point": "ended here: {why}",
    "quality": "reprojection error {residual:.2f} px, {worse:.0f} % of the points have a larger "
    "one; parallax {parallax:.2f} deg",
    "sigma": "; standard deviation {sigma:.4f} baselines in the worst direction, {share:.2f} % of "
    "the depth",
}


@dataclass(frozen=True)
class Life:
    """The life of a keypoint, of a match or of a point.

    Attributes:
        title: what it is.
        steps: pairs of a stage (detected, matched, fused, estimated, triangulated, quality) and
            what happened there, in order.
        match, point: rows of the match and of the point that it became; None for none.
        fate: the outcome, as in docs/recording.md.
    """

    title: str
    steps: tuple[tuple[str, str], ...]
    match: int | None
    point: int | None
    fate: str

    def __str__(self) -> str:
        return f"{self.title}: {self.fate}\n{facts(self.steps)}"


def reasons(tables: Tables) -> dict[str, str]:
    """Explain each fate that ends a life, with the limits of this run."""
    options = tables.report["options"]
    limit = options["estimate"]["threshold_px"]
    return {
        OFF_LINE: f"an inlier lies within {limit:g} px of its epipolar line",
        OFF_HOMOGRAPHY: f"an inlier lies within {limit:g} px of where the homography maps it",
        BEHIND: "its rays meet behind a camera",
        NO_GEOMETRY: tables.report["verdict"]["reason"],
        INLIER: "the verdict permits no points, or its point is behind a camera, not finite or "
        "outside the limits of triangulation",
    }


def matching_rule(tables: Tables, operator: str) -> str:
    """Describe which keypoints an operator's matcher pairs."""
    options = tables.report["options"]["match"]
    matcher = options["matchers"].get(operator, options["matcher"])
    if matcher != "nearest":
        return f"the matcher {matcher} accepted no keypoint of the other image"
    rule = "a match needs the nearest descriptor" + (
        " in both directions" if options["mutual"] else ""
    )
    if options["max_ratio"] is not None:
        rule += f", at most {options['max_ratio']:g} of the second-best distance"
    if options["max_distance"] is not None:
        rule += f", at most {options['max_distance']:g} away"
    return rule


def keypoint_life(tables: Tables, operator: str, image: int, n: int) -> Life:
    """Follow keypoint `n` of an operator in image 1 or 2.

    Raises:
        RecordingError: no such keypoint.
    """
    total = len(tables.keypoints[operator][image - 1].xy)
    if not 0 <= n < total:
        raise RecordingError(f"{operator} has keypoints 0 to {total - 1} in image {image}, not {n}")
    title = WORDS["keypoint"].format(operator=operator, keypoint=n, image=image)
    k = tables.keypoints[operator][image - 1]
    steps = [("detected", _detected(tables, operator, image, n))]
    if k.partner[n] < 0:
        words = WORDS["unmatched"].format(rule=matching_rule(tables, operator))
        return Life(title, (*steps, ("matched", words)), None, None, "unmatched")
    steps.append(("matched", _matched(tables, operator, image, n)))
    row = int(k.match[n])
    if k.merged[n]:
        steps.append(("fused", _merged(tables, row)))
        fate = f"merged into a duplicate; {tables.matches.fate[row]}" if row >= 0 else "merged"
    else:
        steps.append(("fused", _kept(tables, row)))
        fate = str(tables.matches.fate[row])
    if row < 0:
        return Life(title, tuple(steps), None, None, fate)
    point = int(tables.matches.point[row])
    steps += _estimated(tables, row)
    return Life(title, tuple(steps), row, point if point >= 0 else None, fate)


def match_life(tables: Tables, n: int) -> Life:
    """Follow match `n` of the fused correspondences.

    Raises:
        RecordingError: no such match.
    """
    m, total = tables.matches, len(tables.matches.kept)
    if not 0 <= n < total:
        raise RecordingError(
            f"there is no match {n}; the recording has "
            + (f"0 to {total - 1}" if total else "none")
        )
    operator = tables.operators[int(m.kept[n])]
    first, second = int(m.keypoint1[n]), int(m.keypoint2[n])
    steps = [
        ("detected", _detected(tables, operator, 1, first)),
        ("", _detected(tables, operator, 2, second)),
        ("matched", _matched(tables, operator, 1, first)),
        ("fused", _kept(tables, n)),
    ]
    for name in tables.operators:
        k = tables.keypoints[name][0]
        for i in np.flatnonzero(k.merged & (k.match == n)).tolist():
            steps.append(("", _joined(tables, name, i)))
    point = int(m.point[n])
    return Life(
        WORDS["match"].format(match=n, total=total),
        (*steps, *_estimated(tables, n)),
        n,
        point if point >= 0 else None,
        str(m.fate[n]),
    )


def point_life(tables: Tables, n: int) -> Life:
    """Follow point `n` of the cloud: the life of its match, under the point's number.

    Raises:
        RecordingError: the recording has no cloud, or the cloud no such point.
    """
    total = len(tables.points.xyz)
    if not total:
        verdict = tables.report["verdict"]["kind"]
        raise RecordingError(f"the recording has no cloud; its verdict is: {verdict}")
    if not 0 <= n < total:
        raise RecordingError(f"there is no point {n}; the recording has points 0 to {total - 1}")
    life = match_life(tables, int(np.flatnonzero(tables.matches.point == n)[0]))
    return replace(life, title=f"{WORDS['point'].format(point=n, total=total)}, {life.title}")


def _joined(tables: Tables, operator: str, n: int) -> str:
    """The merged match that keypoint `n` of image 1 was part of."""
    first, second = tables.keypoints[operator]
    partner = int(first.partner[n])
    (x1, y1), (x2, y2) = first.xy[n], second.xy[partner]
    return WORDS["joined"].format(
        operator=operator, keypoint1=n, keypoint2=partner, x1=x1, y1=y1, x2=x2, y2=y2
    )


def _detected(tables: Tables, operator: str, image: int, n: int) -> str:
    k = tables.keypoints[operator][image - 1]
    return WORDS["detected"].format(
        operator=operator,
        image=image,
        keypoint=n,
        x=k.xy[n, 0],
        y=k.xy[n, 1],
        scale=k.scale_px[n],
        angle=k.angle_deg[n],
        response=k.response[n],
    )


def _matched(tables: Tables, operator: str, image: int, n: int) -> str:
    k, other = tables.keypoints[operator][image - 1], 3 - image
    x, y = tables.keypoints[operator][other - 1].xy[k.partner[n]]
    words = WORDS["matched"].format(
        partner=int(k.partner[n]), other=other, x=x, y=y, distance=k.distance[n]
    )
    return words + (WORDS["ratio"].format(ratio=k.ratio[n]) if np.isfinite(k.ratio[n]) else "")


def _kept(tables: Tables, row: int) -> str:
    mask = int(tables.matches.mask[row])
    found_by = [name for i, name in enumerate(tables.operators) if mask >> i & 1]
    kept = tables.operators[int(tables.matches.kept[row])]
    return WORDS["kept"].format(kept=kept, operators=", ".join(found_by))


def _merged(tables: Tables, row: int) -> str:
    radius = tables.report["options"]["fuse"]["merge_radius"]
    kept = tables.operators[int(tables.matches.kept[row])] if row >= 0 else "-"
    return WORDS["merged"].format(match=row, kept=kept, radius=0.0 if radius is None else radius)


def _estimated(tables: Tables, row: int) -> list[tuple[str, str]]:
    m, fate = tables.matches, str(tables.matches.fate[row])
    distance, n = float(m.distance_px[row]), int(m.point[row])
    why = reasons(tables).get(fate, "")
    if fate not in (POINT, INLIER):
        kind = "outlier" if np.isfinite(distance) else "no geometry"
        words = WORDS[kind].format(
            reason=fate.removeprefix("outlier: "), distance=distance, why=why
        )
        return [("estimated", words)]
    steps = [("estimated", WORDS["inlier"].format(distance=distance))]
    if n < 0:
        return [*steps, ("triangulated", WORDS["no point"].format(why=why))]
    p = tables.points
    x, y, z = p.xyz[n]
    worse = 100 * int((p.residual_px > p.residual_px[n]).sum()) / len(p.residual_px)
    quality = WORDS["quality"].format(
        residual=p.residual_px[n], worse=worse, parallax=p.parallax_deg[n]
    )
    if np.isfinite(p.sigma[n]):
        share = 100 * float(p.sigma[n]) / float(z)
        quality += WORDS["sigma"].format(sigma=p.sigma[n], share=share)
    steps.append(("triangulated", WORDS["triangulated"].format(point=n, x=x, y=y, z=z)))
    return [*steps, ("quality", quality)]
