"""Bad input to the commands: a clear message, the right exit status, no incomplete output."""

from __future__ import annotations

import errno
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import cv2
import numpy as np
import pytest
from click.testing import CliRunner
from PIL import Image as PILImage

import sfmkit
from sfmkit.cli import main
from sfmkit.datasets.synthetic import demo_pair
from sfmkit.errors import InputError

K = "500,500,319.5,239.5"


@pytest.fixture(scope="module")
def small_pair(tmp_path_factory) -> tuple[Path, Path, str]:
    """The bundled pair at 480 pixels wide, as PNG, and its intrinsics as the command takes them."""
    folder = tmp_path_factory.mktemp("pair")
    image1, image2, truth = demo_pair()
    K_full, (w, h) = (json.loads(Path(truth).read_text())[k] for k in ("K", "size_wh"))
    s = 480 / w
    paths = []
    for number, path in enumerate((image1, image2), start=1):
        small = cv2.resize(cv2.imread(str(path)), (480, round(h * s)), interpolation=cv2.INTER_AREA)
        paths.append(folder / f"{number}.png")
        cv2.imwrite(str(paths[-1]), small)
    focal = f"{K_full[0][0] * s},{K_full[1][1] * s}"
    centre = f"{(K_full[0][2] + 0.5) * s - 0.5},{(K_full[1][2] + 0.5) * s - 0.5}"
    return paths[0], paths[1], f"{focal},{centre}"


def run(*arguments, out: Path, operators="orb,fast-brief", extra=()):
    command = [
        "reconstruct",
        *map(str, arguments),
        "--operators",
        operators,
        "--out",
        str(out),
        "--no-rrd",
        *extra,
    ]
    return CliRunner().invoke(main, command)


def is_refused(result, out: Path, *words: str) -> None:
    """Exit status 2, a message on standard error with these words, no traceback, and no output
    folder."""
    assert result.exit_code == 2, result.output
    message = result.stderr.lower()
    for word in words:
        assert word.lower() in message, message
    assert "traceback" not in message
    assert not out.exists()
    assert [p.name for p in out.parent.iterdir() if p.name.startswith(".sfmkit-")] == []


# --- images


def test_missing_file(small_pair, tmp_path):
    is_refused(
        run(small_pair[0], tmp_path / "no.png", out=tmp_path / "o"), tmp_path / "o", "no.png"
    )


def test_directory(small_pair, tmp_path):
    (tmp_path / "d").mkdir()
    is_refused(run(small_pair[0], tmp_path / "d", out=tmp_path / "o"), tmp_path / "o", "director")


def test_empty_file(small_pair, tmp_path):
    (tmp_path / "e.jpg").touch()
    is_refused(run(small_pair[0], tmp_path / "e.jpg", out=tmp_path / "o"), tmp_path / "o", "empty")


def test_truncated_jpeg(small_pair, tmp_path):
    whole = Path(demo_pair()[0]).read_bytes()
    (tmp_path / "t.jpg").write_bytes(whole[: len(whole) // 2])
    is_refused(
        run(tmp_path / "t.jpg", small_pair[1], out=tmp_path / "o"), tmp_path / "o", "truncated"
    )


def test_text_named_png(small_pair, tmp_path):
    (tmp_path / "t.png").write_text("this is not a picture\n" * 50)
    is_refused(run(tmp_path / "t.png", small_pair[1], out=tmp_path / "o"), tmp_path / "o", "image")


@pytest.mark.parametrize("kind", ["16 bit", "RGBA", "grey", "CMYK"])
def test_other_kinds_of_image_work(small_pair, tmp_path, kind):
    picture = PILImage.open(small_pair[0])
    path = tmp_path / ("k.tif" if kind == "CMYK" else "k.png")
    if kind == "16 bit":
        cv2.imwrite(
            str(path), cv2.imread(str(small_pair[0]), cv2.IMREAD_GRAYSCALE).astype(np.uint16) * 257
        )
    else:
        picture.convert({"RGBA": "RGBA", "grey": "L", "CMYK": "CMYK"}[kind]).save(path)
    result = run(path, small_pair[1], out=tmp_path / "o", extra=("--intrinsics", small_pair[2]))
    assert result.exit_code == 0, result.output
    assert json.loads((tmp_path / "o/report.json").read_text())["operators"]["multi"]["points"] > 50


@pytest.mark.parametrize("size_wh", [(1, 1), (40_000, 24)])
def test_extreme_sizes_end_in_a_verdict(small_pair, tmp_path, size_wh):
    path = tmp_path / "x.png"
    PILImage.fromarray(
        np.random.default_rng(0).integers(0, 255, (*size_wh[::-1], 3), np.uint8)
    ).save(path)
    intrinsics = f"500,500,{(size_wh[0] - 1) / 2},{(size_wh[1] - 1) / 2}"
    result = run(
        small_pair[0],
        path,
        out=tmp_path / "o",
        extra=("--intrinsics", small_pair[2], "--intrinsics2", intrinsics),
    )
    assert result.exit_code == 1, result.output
    assert (
        json.loads((tmp_path / "o/report.json").read_text())["verdict"]["kind"]
        == "too little evidence"
    )


def test_identical_images_are_not_a_stereo_pair(small_pair, tmp_path):
    result = run(
        small_pair[0], small_pair[0], out=tmp_path / "o", extra=("--intrinsics", small_pair[2])
    )
    report = json.loads((tmp_path / "o/report.json").read_text())
    assert result.exit_code == 0, result.output
    assert report["verdict"]["kind"] == "pure rotation"
    assert np.allclose(report["pose"]["R"], np.eye(3), atol=1e-6)
    assert report["pose"]["t"] is None
    assert not (tmp_path / "o/cloud.ply").exists()


def test_blank_images(tmp_path):
    PILImage.new("RGB", (640, 480), "white").save(tmp_path / "b.png")
    result = run(
        tmp_path / "b.png", tmp_path / "b.png", out=tmp_path / "o", extra=("--intrinsics", K)
    )
    assert result.exit_code == 1, result.output
    report = json.loads((tmp_path / "o/report.json").read_text())
    assert report["verdict"]["kind"] == "too little evidence"
    assert any("found nothing" in w for w in report["warnings"])


def test_no_overlap(small_pair, tmp_path):
    other = cv2.GaussianBlur(
        np.random.default_rng(1).integers(0, 255, (360, 480), np.uint8), (0, 0), 2
    )
    cv2.imwrite(str(tmp_path / "other.png"), cv2.normalize(other, None, 0, 255, cv2.NORM_MINMAX))
    result = run(
        small_pair[0],
        tmp_path / "other.png",
        out=tmp_path / "o",
        extra=("--intrinsics", small_pair[2], "--intrinsics2", "400,400,239.5,179.5"),
    )
    assert result.exit_code == 1, result.output
    assert json.loads((tmp_path / "o/report.json").read_text())["pose"] is None


def test_images_of_different_sizes_work(small_pair, tmp_path):
    half = cv2.resize(
        cv2.imread(str(small_pair[1])), None, fx=0.75, fy=0.75, interpolation=cv2.INTER_AREA
    )
    cv2.imwrite(str(tmp_path / "half.png"), half)
    fx, fy, cx, cy = (float(v) for v in small_pair[2].split(","))
    scaled = f"{fx * 0.75},{fy * 0.75},{(cx + 0.5) * 0.75 - 0.5},{(cy + 0.5) * 0.75 - 0.5}"
    result = run(
        small_pair[0],
        tmp_path / "half.png",
        out=tmp_path / "o",
        extra=("--intrinsics", small_pair[2], "--intrinsics2", scaled),
    )
    assert result.exit_code == 0, result.output


# --- cameras


@pytest.mark.parametrize(
    "text, word",
    [
        ("0,0,0,0", "positive"),
        ("-500,500,240,180", "positive"),
        ("nan,500,240,180", "nan"),
        ("500,500,99999,180", "principal point"),
        ("500,500", "fx,fy,cx,cy"),
        ("five hundred,500,240,180", "number"),
    ],
)
def test_impossible_intrinsics(small_pair, tmp_path, text, word):
    is_refused(
        run(*small_pair[:2], out=tmp_path / "o", extra=("--intrinsics", text)), tmp_path / "o", word
    )


def test_intrinsics_of_the_wrong_shape(small_pair, tmp_path):
    (tmp_path / "K.txt").write_text("500 0\n0 500\n")
    result = run(
        *small_pair[:2], out=tmp_path / "o", extra=("--intrinsics", str(tmp_path / "K.txt"))
    )
    is_refused(result, tmp_path / "o", "3")


def test_no_intrinsics_at_all_is_a_loud_guess(small_pair, tmp_path):
    run(*small_pair[:2], out=tmp_path / "o")
    report = json.loads((tmp_path / "o/report.json").read_text())
    assert "guess" in report["camera"][0]["source"]
    assert any("guess" in w.lower() for w in report["warnings"])


# --- operators


def test_unknown_operator_suggests_the_nearest(small_pair, tmp_path):
    is_refused(
        run(*small_pair[:2], out=tmp_path / "o", operators="surff"), tmp_path / "o", "'surf'"
    )


def test_no_operator(small_pair, tmp_path):
    is_refused(run(*small_pair[:2], out=tmp_path / "o", operators=","), tmp_path / "o", "operator")


def test_an_operator_that_finds_nothing_does_not_stop_the_others(small_pair, tmp_path, monkeypatch):
    from sfmkit.pipeline import stages

    real = stages.detect

    def fast_finds_nothing(image, name, **options):
        found = real(image, name, **options)
        return found.take(np.zeros(0, int)) if name == "fast-brief" else found

    monkeypatch.setattr(stages, "detect", fast_finds_nothing)
    result = run(*small_pair[:2], out=tmp_path / "o", extra=("--intrinsics", small_pair[2]))
    assert result.exit_code == 0, result.output
    report = json.loads((tmp_path / "o/report.json").read_text())
    assert any("fast-brief" in w and "found nothing" in w for w in report["warnings"])
    assert report["operators"]["fast-brief"]["points"] == 0 < report["operators"]["orb"]["points"]


def test_fewer_than_eight_matches(small_pair, tmp_path):
    result = run(
        *small_pair[:2], out=tmp_path / "o", extra=("--intrinsics", small_pair[2], "--budget", "5")
    )
    assert result.exit_code == 1, result.output
    assert "at least 8" in json.loads((tmp_path / "o/report.json").read_text())["verdict"]["reason"]


# --- outputs


def test_existing_folder_is_kept(small_pair, tmp_path):
    out = tmp_path / "o"
    out.mkdir()
    (out / "precious.txt").write_text("keep me")
    result = run(*small_pair[:2], out=out, extra=("--intrinsics", small_pair[2]))
    assert result.exit_code == 2
    assert "--overwrite" in result.stderr
    assert [p.name for p in out.iterdir()] == ["precious.txt"]
    assert (
        run(
            *small_pair[:2], out=out, extra=("--intrinsics", small_pair[2], "--overwrite")
        ).exit_code
        == 0
    )
    assert (out / "report.json").exists()


def test_unwritable_folder(small_pair, tmp_path):
    (tmp_path / "file").write_text("a file is not a folder")
    out = tmp_path / "file" / "o"
    result = run(*small_pair[:2], out=out, extra=("--intrinsics", small_pair[2]))
    assert result.exit_code == 2, result.output
    assert "traceback" not in result.stderr.lower()


def test_disk_full_leaves_nothing_behind_and_the_old_folder_in_place(
    small_pair, tmp_path, monkeypatch
):
    out = tmp_path / "o"
    out.mkdir()
    (out / "old.txt").write_text("old")

    def full(*_args, **_kwargs):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("sfmkit.reports.outputs.write_ply", full)
    result = run(*small_pair[:2], out=out, extra=("--intrinsics", small_pair[2], "--overwrite"))
    assert result.exit_code == 2, result.output
    assert "no space" in result.stderr.lower()
    assert [p.name for p in out.iterdir()] == ["old.txt"]
    assert [p.name for p in tmp_path.iterdir()] == ["o"]


@pytest.mark.slow
def test_ctrl_c_leaves_nothing_behind(tmp_path):
    image1, image2, truth = demo_pair()
    command = [
        sys.executable,
        "-m",
        "sfmkit.cli",
        "reconstruct",
        str(image1),
        str(image2),
        "--intrinsics",
        str(truth),
        "--out",
        str(tmp_path / "o"),
    ]
    # A runner in the background may have told its children to ignore SIGINT.
    process = subprocess.Popen(
        command,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    line = ""
    while "detect" not in line:  # well inside the work
        line = process.stderr.readline()
        assert line, "the command ended before it was interrupted"
    time.sleep(0.2)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=240)
    assert process.returncode == 130, err
    assert "Traceback" not in err
    assert list(tmp_path.iterdir()) == []


def test_a_budget_or_threshold_that_makes_no_sense(small_pair, tmp_path):
    assert run(*small_pair[:2], out=tmp_path / "o", extra=("--budget", "0")).exit_code == 2
    assert (
        run(
            *small_pair[:2],
            out=tmp_path / "o",
            extra=("--threshold", "-1", "--intrinsics", small_pair[2]),
        ).exit_code
        == 2
    )
    assert not (tmp_path / "o").exists()


@pytest.mark.parametrize("run", [sfmkit.reconstruct, sfmkit.register])
def test_operators_and_seed_are_checked_before_images_are_read(run):
    with pytest.raises(InputError, match="at most 62 operators"):
        run("missing.png", "missing.png", operators=("orb",) * 63)
    for seed in (-1, 2**31):
        with pytest.raises(InputError, match="seed must be from 0"):
            run("missing.png", "missing.png", operators=("orb",), seed=seed)


def test_a_distortion_that_folds_inside_the_image_is_a_warning(small_pair, tmp_path):
    """Also for keypoints that have no match, which the recording shows."""
    extra = ("--intrinsics", small_pair[2] + ",-0.6", "--budget", "1500")
    command = ["reconstruct", *map(str, small_pair[:2]), "--operators", "orb", *extra]
    result = CliRunner().invoke(main, [*command, "--out", str(tmp_path / "o")])
    assert result.exit_code in (0, 1), result.output
    warnings = json.loads((tmp_path / "o/report.json").read_text())["warnings"]
    assert any("lie outside the field" in warning for warning in warnings)
    assert (tmp_path / "o/recording.rrd").stat().st_size > 0
