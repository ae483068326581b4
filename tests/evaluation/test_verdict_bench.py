"""The benchmark of verdicts: scenes of repeated texture, pairs, rules and tables."""

from __future__ import annotations

import numpy as np
import pytest

from sfmkit.datasets.middlebury import temple_ring
from sfmkit.datasets.rendering.repeated import KINDS, repeated_scene, repeated_views
from sfmkit.errors import InputError
from sfmkit.evaluation import verdict, verdict_views
from sfmkit.evaluation.rows import RowStore
from sfmkit.evaluation.verdict import OURS, PEERS, bench_verdict
from sfmkit.evaluation.verdict_pairs import BenchPair
from sfmkit.evaluation.verdict_tables import rules, verdict_result
from sfmkit.evaluation.verdict_views import BenchView, overlap
from sfmkit.types import Camera


@pytest.mark.parametrize(
    ("kind", "u", "v"), [("tiles", 0.45, 0.45), ("windows", 1.7, 2.3), ("bricks", 0.52, 0.48)]
)
def test_the_cells_are_copies_without_variation(kind, u, v):
    g = np.random.default_rng(0)
    x, y, size = 3 * g.random(500), 3 * g.random(500), np.full(500, 0.01)
    for variation, same in ((0.0, True), (1.0, False)):
        material = repeated_scene(kind, variation).surfaces[0].material
        a, b = material(x, y, size)[0], material(x + 2 * u, y + v, size)[0]
        assert bool(np.abs(a - b).max() < 1e-5) is same


def test_views_of_different_groups_hardly_overlap():
    scene = repeated_scene("windows", 0.0)
    camera = Camera(scene.K((48, 36)), (48, 36))
    views = [
        BenchView("w", str(k), np.zeros((36, 48, 3), np.uint8), camera, None, (scene, pose))
        for k, pose in enumerate(repeated_views("windows"))
    ]
    shares = np.array([[overlap(a, b) for b in views] for a in views])
    np.testing.assert_allclose(shares, shares.T)
    assert (np.diag(shares) == 1).all()
    assert shares[0, 1] > 0.7
    assert shares[0, 3:].max() == 0
    assert shares[3:6, 7].max() == 0
    assert set(KINDS) == {"tiles", "windows", "bricks", "columns"}


def test_the_temple_ring_is_in_the_order_of_its_cameras(data_dir):
    """Most neighbours are 23 degrees apart; the files are in another order."""
    ring = temple_ring(data_dir)
    axes = np.array([view.R[2] for view in (*ring, ring[0])])
    turns = np.degrees(np.arccos((axes[:-1] * axes[1:]).sum(1).clip(-1, 1)))
    assert len(ring) == 16
    assert np.median(turns) == pytest.approx(22.7, abs=0.2)
    assert turns.max() < 45
    assert turns.sum() == pytest.approx(360, abs=10)


def test_a_mirrored_view_keeps_its_rays():
    """A pixel and its mirror image have rays that differ in the sign of one coordinate."""
    K = np.array([[50.0, 0, 20], [0, 50, 11], [0, 0, 1]])
    view = BenchView("s", "0", np.zeros((30, 40, 3), np.uint8), Camera(K, (40, 30)))
    for axis, (x, sign) in ((1, ((39 - 7.0, 9.0), (-1, 1))), (0, ((7.0, 29 - 9.0), (1, -1)))):
        Q = view.mirrored("m", axis).camera.K
        ray, other = np.linalg.inv(K) @ [7, 9, 1], np.linalg.inv(Q) @ [*x, 1]
        np.testing.assert_allclose(other, ray * [*sign, 1])
    assert view.cropped("c", 10, 30).camera.K[0, 2] == 10


def small_pairs() -> list[BenchPair]:
    """A rendered pair, and the same first photograph against noise."""
    from sfmkit.datasets.synthetic import render

    p = render("courtyard", size_wh=(240, 180), supersample=1)
    one = BenchView("yard", "1", p.image1, p.camera1)
    two = BenchView("yard", "2", p.image2, p.camera2)
    pixels = np.random.default_rng(0).integers(0, 255, (180, 240, 3)).astype(np.uint8)
    noise = BenchView("noise", "1", pixels, p.camera1)
    return [
        BenchPair("rendered", True, one, two, (p.R, p.t)),
        BenchPair("across", False, one, noise, None),
    ]


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    out = tmp_path_factory.mktemp("verdict")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(verdict, "bench_pairs_of_verdicts", lambda data, folder: small_pairs())
        patch.setattr(verdict, "BUDGET", 600)
        first = bench_verdict(out, groups=["rendered"], operators=("orb",), workers=1)
        both = bench_verdict(out, operators=("orb",), workers=1)
        again = bench_verdict(out, operators=("orb",), workers=1)
        with pytest.raises(InputError, match="begins with nothing"):
            bench_verdict(out, groups=["nothing"], operators=("orb",), workers=1)
    return out, first, both, again


def test_a_run_is_resumed_and_every_method_has_a_row(run):
    out, first, both, again = run
    assert len(first) == 4
    assert len(both) == 8
    assert again == both
    assert [row["method"] for row in first] == [OURS, *PEERS.values()]
    assert all(max(row["rotation_deg"], row["translation_deg"]) < 5 for row in first)
    assert not both[4]["pose"]
    assert RowStore(out / "rows.jsonl", {}).path.is_file()


def test_the_table_counts_what_the_rules_accept(run):
    out, _, rows, _ = run
    result = verdict_result(rows, out, "sfmkit bench verdict")
    methods, groups = result.tables
    assert (out / "roc.png").stat().st_size > 10_000
    assert [line[0] for line in methods.rows] == [rule.name for rule in rules()]
    assert methods.rows[0][1] == 1  # accepted and right
    assert methods.rows[0][-1] == 1.0
    wrong = [line[4] for line in methods.rows]
    for rule, count in zip(rules(), wrong):
        noisy = [row for row in rows[4:] if row["method"] == rule.method]
        assert count == sum(rule.accepts(row) for row in noisy)
    assert groups.rows[0][:4] == ("rendered", 1, 1, 1)


def test_the_photographs_fit_the_size_of_the_benchmark(data_dir):
    drone = verdict_views.drone(data_dir)
    assert {max(view.camera.size_wh) for view in drone} == {verdict_views.LONGEST}
    assert all(view.image.shape[1::-1] == view.camera.size_wh for view in drone)
