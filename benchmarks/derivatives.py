"""Check derivatives and transforms of every public function of sfmkit.geometry.

    python benchmarks/derivatives.py [--compile] [--only NAME ...]

Writes docs/derivatives.md. Each function is evaluated at one generic point of a noisy scene; its
arguments are free parameters (a rotation vector for R; focal lengths, principal point and skew for
K), so that a perturbation stays on the manifold. ``--only`` prints the rows of some functions.
``--compile`` fills the last column: one graph without breaks, traced by torch.compile with the
backend aot_eager, compared with eager execution.
"""

from __future__ import annotations

import argparse
import dataclasses
import inspect
import signal
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import torch
from kornia.geometry.camera import PinholeCamera
from torch import Tensor
from torch.autograd.gradcheck import GradcheckError

import sfmkit.geometry as sg
from sfmkit.types import Camera

D = torch.float64
PAGE = Path(__file__).resolve().parents[1] / "docs" / "derivatives.md"
YES, NO, WRONG, NONE = "yes", "raises", "wrong", "–"
_STEP = 1e-5  # relative step of finite differences
_COMPILE_SECONDS = 120


class Case(NamedTuple):
    """A function of free parameters, and the point at which it is checked."""

    function: Callable[..., Any]
    at: tuple[Tensor, ...]


def intrinsics(k: Tensor) -> Tensor:
    """Return K of (fx, fy, cx, cy, skew)."""
    zero, one = torch.zeros_like(k[..., 0]), torch.ones_like(k[..., 0])
    fx, fy, cx, cy, skew = k.unbind(-1)
    return torch.stack((fx, skew, cx, zero, fy, cy, zero, zero, one), -1).unflatten(-1, (3, 3))


def signed(M: Tensor) -> Tensor:
    """Return matrices whose sign is arbitrary with a positive entry (2, 1)."""
    return M * M[..., 2:, 1:2].detach().sign()


def cases() -> dict[str, Case]:
    """Return one case per public function."""
    g = torch.Generator().manual_seed(0)

    def normal(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=g, dtype=D)

    w, t = torch.tensor([0.1, -0.2, 0.05], dtype=D), torch.tensor([0.97, 0.2, -0.1], dtype=D)
    t = t / t.norm()
    k1 = torch.tensor([800.0, 810, 320, 240, 0.5], dtype=D)
    k2 = torch.tensor([900.0, 890, 300, 250, 1.0], dtype=D)
    K1, K2, R = intrinsics(k1), intrinsics(k2), sg.so3_exp(w)
    X = torch.rand(14, 3, generator=g, dtype=D) * torch.tensor([4.0, 3, 4]) + torch.tensor(
        [-2.0, -1.5, 4]
    )
    n, d = torch.tensor([-0.3, 0.2, 1.0], dtype=D), torch.tensor(6.0, dtype=D)
    n, d = n / n.norm(), d / n.norm()
    flat = X.clone()
    flat[:, 2] = 6 + 0.3 * X[:, 0] - 0.2 * X[:, 1]
    x1 = sg.project(X, K1) + 0.3 * normal(14, 2)
    x2 = sg.project(X, K2, R, t) + 0.3 * normal(14, 2)
    y1 = sg.project(flat, K1) + 0.3 * normal(14, 2)
    y2 = sg.project(flat, K2, R, t) + 0.3 * normal(14, 2)
    n1, n2 = sg.normalize(x1, K1), sg.normalize(x2, K2)
    E, F = sg.essential_from_pose(R, t), sg.fundamental_from_pose(R, t, K1, K2)
    H = sg.homography_from_pose(R, t, n, d, K1, K2)
    M = sg.fundamental_8point(n1 * 1.2, n2 * 1.2)  # coordinates for a wrong focal length
    square = torch.tensor([0.1, 0.7, 0.95, 1.5], dtype=D)
    poly, P = torch.tensor([-0.2, 0.05, 1e-3, -2e-3], dtype=D), normal(2, 3, 4)
    camera = Camera(K1.numpy() * [[1, 0, 1], [0, 1, 1], [1, 1, 1]], (640, 480), poly.numpy())
    plain = Camera(camera.K, (640, 480))
    covered = 1e-3 * normal(5, 5)
    rot, mat = sg.so3_exp, intrinsics

    def refined(w: Tensor, t: Tensor, x1: Tensor, x2: Tensor, k1: Tensor, k2: Tensor) -> Any:
        return sg.refine_essential(rot(w), t, x1, x2, mat(k1), mat(k2)).pose

    def with_focal(w: Tensor, t: Tensor, x1: Tensor, x2: Tensor, k1: Tensor, k2: Tensor) -> Any:
        found = sg.refine_focal(rot(w), t, x1, x2, mat(k1), mat(k2))
        return found.R, found.t, found.scale

    def bundle(x1: Tensor, x2: Tensor, k1: Tensor, k2: Tensor, w: Tensor, t: Tensor) -> Any:
        return sg.bundle_adjust(x1, x2, mat(k1), mat(k2), rot(w), t, loss="cauchy")

    def minimum(*a: Tensor) -> tuple[Tensor, ...]:
        b = bundle(*a)
        return b.R, b.t, b.inverse_depth

    def pose_of_pinhole(w: Tensor, t: Tensor) -> tuple[Tensor, Tensor]:
        M = sg.se3_from_pose(rot(w)[None], t[None]).matrix()
        K = torch.nn.functional.pad(K1[None], (0, 1, 0, 1))
        height, width = torch.tensor([480.0]), torch.tensor([640.0])
        return sg.camera_from_pinhole(PinholeCamera(K, M, height, width))[1:]

    def of_pose(function: Callable[..., Any]) -> Callable[..., Any]:
        return lambda n1, n2, w, t: function(n1, n2, rot(w), t)

    def of_four(w: Tensor, t: Tensor, n1: Tensor, n2: Tensor) -> Any:
        turns = torch.stack((rot(w), rot(-3 * w)), -3)
        return sg.choose_pose(turns, torch.stack((t, t), -2), n1, n2)[:2]

    def residual(X: Tensor, x1: Tensor, x2: Tensor, k: Tensor, w: Tensor, t: Tensor) -> Tensor:
        return sg.reprojection_residuals(X, x1, x2, mat(k), mat(k), rot(w), t)

    def error(X: Tensor, x1: Tensor, x2: Tensor, k: Tensor, w: Tensor, t: Tensor) -> Tensor:
        return sg.reprojection_error(X, x1, x2, mat(k), mat(k), rot(w), t)

    def linearised(w: Tensor, t: Tensor, x1: Tensor, x2: Tensor, k1: Tensor, k2: Tensor) -> Any:
        return sg.linearise_pose(rot(w), t, x1, x2, mat(k1), mat(k2), loss_scale=2.0)

    def derivatives(w: Tensor, t: Tensor, x1: Tensor, x2: Tensor, k1: Tensor, k2: Tensor) -> Any:
        return sg.point_derivatives(rot(w), t, x1, x2, mat(k1), mat(k2))

    views = (w, t, x1, x2, k1, k2)
    sensitivity, blocks = linearised(*views), torch.arange(14) // 2
    sigma = torch.tensor([0.01, 2.0, 3.0, 0.02], dtype=D)
    by_point = derivatives(*views)

    def parts(**given: Tensor) -> sg.Sensitivity:
        kind = next(iter(given.values())).dtype
        fields = {f.name: getattr(sensitivity, f.name) for f in dataclasses.fields(sensitivity)}
        return sg.Sensitivity(**{name: a.to(kind) for name, a in (fields | given).items()})

    seen, two = (x1[:9], x2[:9], k1, k2, w, t), (n1, n2, w, t)
    return {
        "bundle_adjust": Case(minimum, seen),
        "camera_covariance": Case(
            lambda b, s1, s2: sg.camera_covariance(parts(by_intrinsics=b), s1, s2, False),
            (sensitivity.by_intrinsics, sigma, 2 * sigma),
        ),
        "camera_from_pinhole": Case(pose_of_pinhole, (w, t)),
        "check_pose": Case(lambda w, t: sg.check_pose(rot(w), t), (w, t)),
        "cheirality": Case(of_pose(sg.cheirality), two),
        "choose_pose": Case(of_four, (w, t, n1, n2)),
        "clip_lines": Case(
            lambda F, x: sg.clip_lines(sg.epipolar_lines(F, x), (640, 480)), (F, x1)
        ),
        "corrected_matches": Case(of_pose(sg.corrected_matches), two),
        "covariance": Case(lambda *a: sg.covariance(bundle(*a)), seen),
        "decompose_essential": Case(sg.decompose_essential, (E,)),
        "decompose_homography": Case(
            lambda H, k1, k2: sg.decompose_homography(H, mat(k1), mat(k2)), (H, k1, k2)
        ),
        "denormalize": Case(lambda x, k: sg.denormalize(x, mat(k)), (n1, k1)),
        "distort": Case(sg.distort, (n1, poly)),
        "distort_pixels": Case(lambda x: sg.distort_pixels(x, camera), (x1,)),
        "epipolar_lines": Case(sg.epipolar_lines, (F, x1)),
        "epipoles": Case(lambda F: tuple(e * e for e in sg.epipoles(F)), (F,)),
        "essential_5point": Case(
            lambda a, b: signed(sg.essential_5point(a, b)[0][..., :1, :, :]), (n1[:5], n2[:5])
        ),
        "essential_from_fundamental": Case(
            lambda F, k1, k2: sg.essential_from_fundamental(F, mat(k1), mat(k2)), (F, k1, k2)
        ),
        "essential_from_pose": Case(lambda w, t: sg.essential_from_pose(rot(w), t), (w, t)),
        "fit_similarity": Case(sg.fit_similarity, (X, X.flip(-1) + normal(14, 3))),
        "from_homogeneous": Case(sg.from_homogeneous, (X,)),
        "fundamental_7point": Case(
            lambda a, b: signed(sg.fundamental_7point(a, b)[0][..., :1, :, :]), (x1[:7], x2[:7])
        ),
        "fundamental_8point": Case(lambda *a: signed(sg.fundamental_8point(*a)), (x1, x2)),
        "fundamental_from_essential": Case(
            lambda E, k1, k2: sg.fundamental_from_essential(E, mat(k1), mat(k2)), (E, k1, k2)
        ),
        "fundamental_from_pose": Case(
            lambda w, t, k1, k2: sg.fundamental_from_pose(rot(w), t, mat(k1), mat(k2)),
            (w, t, k1, k2),
        ),
        "fundamental_from_projections": Case(sg.fundamental_from_projections, (P[0], P[1])),
        "hartley_normalization": Case(sg.hartley_normalization, (x1,)),
        "hat": Case(sg.hat, (w,)),
        "homography_4point": Case(sg.homography_4point, (y1[:4], y2[:4])),
        "homography_dlt": Case(sg.homography_dlt, (y1, y2)),
        "homography_from_pose": Case(
            lambda w, t, n, d, k1, k2: sg.homography_from_pose(rot(w), t, n, d, mat(k1), mat(k2)),
            (w, t, n, d, k1, k2),
        ),
        "image_blocks": Case(lambda x: sg.image_blocks(x, (640, 480)), (x1,)),
        "influence": Case(lambda *a: sg.influence(bundle(*a)), seen),
        "inverse_intrinsics": Case(lambda k: sg.inverse_intrinsics(mat(k)), (k1,)),
        "jackknife_covariance": Case(
            lambda s, h: sg.jackknife_covariance(parts(score=s, hessian=(h + h.mT) / 2), blocks),
            (sensitivity.score, sensitivity.hessian),
        ),
        "linearise_pose": Case(linearised, views),
        "loss_terms": Case(lambda s: sg.loss_terms("cauchy", s, 0.8), (square,)),
        "marginal_score": Case(lambda s: sg.marginal_score(s, 1.1), (square,)),
        "marginal_weight": Case(lambda s: sg.marginal_weight(s, 1.1), (square,)),
        "normalize": Case(lambda x, k: sg.normalize(x, mat(k)), (x1, k1)),
        "one_focal": Case(lambda M: sg.one_focal(M)[0], (M,)),
        "parallax": Case(lambda a, b, w: sg.parallax(a, b, rot(w)), (n1, n2, w)),
        "pinhole_from_camera": Case(
            lambda w, t: sg.pinhole_from_camera(plain, rot(w), t).extrinsics, (w, t)
        ),
        "point_covariances": Case(
            lambda points, by, before, pose, b, s1: sg.point_covariances(
                points, by, before, pose, parts(by_intrinsics=b), s1, 2 * s1, False
            ),
            (
                *(normal(14, 3, 3), by_point, covered @ covered.T, 2 * covered @ covered.T),
                *(sensitivity.by_intrinsics, sigma),
            ),
        ),
        "point_derivatives": Case(derivatives, views),
        "pose_auc": Case(lambda e: sg.pose_auc(e, (5.0, 10.0)), (10 * square,)),
        "pose_from_se3": Case(lambda w, t: sg.pose_from_se3(sg.se3_from_pose(rot(w), t)), (w, t)),
        "pose_sensitivity": Case(lambda *a: sg.pose_sensitivity(bundle(*a)), seen),
        "project": Case(
            lambda X, k, w, t, d: sg.project(X, mat(k), rot(w), t, d), (X, k1, w, t, poly)
        ),
        "project_to_essential": Case(sg.project_to_essential, (E + 0.1 * normal(3, 3),)),
        "refine_essential": Case(refined, (w, t, x1, x2, k1, k2)),
        "refine_focal": Case(with_focal, (w, t, x1, x2, k1, k2)),
        "refine_homography": Case(
            lambda H, a, b: sg.transfer(sg.refine_homography(H, a, b), a), (H, y1, y2)
        ),
        "relative_pose": Case(
            lambda a, s, b, t: sg.relative_pose(rot(a), s, rot(b), t), (w, t, -2 * w, n)
        ),
        "reprojection_error": Case(error, (X, x1, x2, k1, w, t)),
        "reprojection_residuals": Case(residual, (X, x1, x2, k1, w, t)),
        "rotation_error": Case(lambda a, b: sg.rotation_error(rot(a), rot(b)), (w, -2 * w)),
        "se3_from_pose": Case(lambda w, t: sg.se3_from_pose(rot(w), t).matrix(), (w, t)),
        "sigma_degrees": Case(sg.sigma_degrees, (covered @ covered.T,)),
        "shared_focal": Case(lambda M: sg.shared_focal(M)[0], (M,)),
        "signed_sampson_distance": Case(sg.signed_sampson_distance, (F, x1, x2)),
        "so3_exp": Case(sg.so3_exp, (w,)),
        "so3_log": Case(sg.so3_log, (R,)),
        "sphere_exp": Case(sg.sphere_exp, (t, torch.linalg.cross(t, w))),
        "squared_homography_sampson_distance": Case(
            sg.squared_homography_sampson_distance, (H, y1, y2)
        ),
        "squared_sampson_distance": Case(sg.squared_sampson_distance, (F, x1, x2)),
        "squared_symmetric_epipolar_distance": Case(
            sg.squared_symmetric_epipolar_distance, (F, x1, x2)
        ),
        "squared_symmetric_transfer_error": Case(sg.squared_symmetric_transfer_error, (H, y1, y2)),
        "squared_transfer_error": Case(sg.squared_transfer_error, (H, y1, y2)),
        "tangent_basis": Case(sg.tangent_basis, (t,)),
        "to_homogeneous": Case(sg.to_homogeneous, (x1,)),
        "transfer": Case(sg.transfer, (H, y1)),
        "translation_error": Case(sg.translation_error, (t, n)),
        "triangulate": Case(of_pose(sg.triangulate), two),
        "triangulate_dlt": Case(of_pose(sg.triangulate_dlt), two),
        "triangulate_midpoint": Case(of_pose(sg.triangulate_midpoint), two),
        "triangulate_optimal": Case(of_pose(sg.triangulate_optimal), two),
        "two_focals": Case(lambda M: sg.two_focals(M)[:2], (M,)),
        "undistort": Case(sg.undistort, (n1, poly)),
        "undistort_pixels": Case(lambda x: sg.undistort_pixels(x, camera), (x1,)),
    }


def public_functions() -> list[str]:
    """Return the names of the public functions, without the classes."""
    return [n for n in sg.__all__ if not inspect.isclass(getattr(sg, n))]


def tensors(value: Any) -> Iterator[Tensor]:
    """Yield the floating-point tensors of a result."""
    if isinstance(value, Tensor):
        if value.is_floating_point():
            yield value
    elif isinstance(value, tuple):
        for part in value:
            yield from tensors(part)
    elif dataclasses.is_dataclass(value):
        for field in dataclasses.fields(value):
            yield from tensors(getattr(value, field.name))


class Check:
    """The checks of one function; arguments and results are scaled to the order of one."""

    def __init__(self, case: Case) -> None:
        self.case = case
        # Per entry, because the entries of F and H differ by orders of magnitude.
        self.units = [a.abs().clamp(min=1e-6 * float(a.detach().abs().max())) for a in case.at]
        self.at = tuple(a / u for a, u in zip(case.at, self.units))
        found = self.values(*self.at)
        self.outputs = len(found)
        self.sizes = [max(float(f.detach().abs().max()), 1e-300) for f in found]

    def values(self, *at: Tensor) -> tuple[Tensor, ...]:
        return tuple(
            tensors(self.case.function(*(a * u.to(a.dtype) for a, u in zip(at, self.units))))
        )

    def scaled(self, *at: Tensor) -> tuple[Tensor, ...]:
        return tuple(f / s for f, s in zip(self.values(*at), self.sizes))

    def leaves(self) -> tuple[Tensor, ...]:
        return tuple(a.clone().requires_grad_() for a in self.at)

    def batched(self) -> tuple[Tensor, ...]:
        return tuple(torch.stack((a, a * (1 + 1e-6))) for a in self.at)

    def gradcheck(self) -> bool:
        return torch.autograd.gradcheck(
            self.scaled, self.leaves(), eps=_STEP, atol=1e-4, rtol=1e-3, fast_mode=True
        )

    def gradgradcheck(self) -> bool:
        return torch.autograd.gradgradcheck(
            self.scaled, self.leaves(), eps=_STEP, atol=1e-3, rtol=1e-3, fast_mode=True
        )

    def jacobian(self, transform: Callable[..., Any]) -> bool:
        """Compare the product of a random vector with the Jacobian to that of one backward pass."""
        g = torch.Generator().manual_seed(1)
        leaves = self.leaves()
        results = self.scaled(*leaves)
        vectors = [torch.randn(f.shape, generator=g, dtype=f.dtype) for f in results]
        expected = torch.autograd.grad(results, leaves, vectors, materialize_grads=True)
        found = transform(self.scaled, argnums=tuple(range(len(self.at))))(*self.at)
        for k, e in enumerate(expected):
            product = sum(
                torch.tensordot(v, J[k], v.ndim) for v, J in zip(vectors, found, strict=True)
            )
            if not _close(product, e, 1e-6):  # type: ignore[arg-type]
                return False
        return True

    def jacrev(self) -> bool:
        return self.jacobian(torch.func.jacrev)

    def jacfwd(self) -> bool:
        return self.jacobian(torch.func.jacfwd)

    def vmap(self) -> bool:
        return self.agree(torch.func.vmap(self.scaled)(*self.batched()))

    def batch(self) -> bool:
        return self.agree(self.scaled(*self.batched()))

    def agree(self, together: tuple[Tensor, ...]) -> bool:
        alone = [torch.stack(f) for f in zip(*(self.scaled(*a) for a in zip(*self.batched())))]
        return all(_close(a, b, 1e-6) for a, b in zip(together, alone, strict=True))

    def float32(self) -> bool:
        low = self.scaled(*(a.float() for a in self.at))
        if any(a.dtype != torch.float32 for a in low):
            raise TypeError("the output is float64")
        return all(_close(a.double(), b, 1e-2) for a, b in zip(low, self.scaled(*self.at)))

    def compile(self) -> bool:
        torch._dynamo.reset()
        compiled = torch.compile(self.scaled, backend="aot_eager", fullgraph=True)
        with _limit(_COMPILE_SECONDS):
            found = compiled(*self.at)
        return all(_close(a, b, 1e-6) for a, b in zip(found, self.scaled(*self.at), strict=True))


CHECKS = ("gradcheck", "gradgradcheck", "jacrev", "jacfwd", "vmap", "batch", "float32")
_DERIVATIVES = CHECKS[:4]


def _close(a: Tensor, b: Tensor, tolerance: float) -> bool:
    if a.shape != b.shape:
        return False
    a, b = a.detach(), b.detach()
    largest = b.nan_to_num(posinf=0, neginf=0).abs().amax().clamp(min=1.0)
    return torch.allclose(a, b, rtol=tolerance, atol=tolerance * float(largest), equal_nan=True)


@contextmanager
def _limit(seconds: int) -> Iterator[None]:
    def stop(*_: object) -> None:
        raise TimeoutError

    before = signal.signal(signal.SIGALRM, stop)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


class Entry(NamedTuple):
    """One entry of the table, with the message of a failure."""

    text: str
    message: str = ""


def entry(check: Check, name: str) -> Entry:
    """Run one check."""
    if check.outputs == 0 and name != "compile":
        return Entry(NONE)
    if name in _DERIVATIVES and not all(f.requires_grad for f in check.scaled(*check.leaves())):
        return Entry("no derivative")
    try:
        return Entry(YES if getattr(check, name)() else WRONG)
    except GradcheckError as error:
        return Entry(WRONG, str(error))
    except TypeError as error:
        return Entry("float64" if name == "float32" else NO, str(error))
    except Exception as error:  # any error of torch is a result of the check
        return Entry(NO, f"{type(error).__name__}: {error}")


def table(names: list[str], checks: tuple[str, ...], every: dict[str, Case]) -> list[str]:
    """Return the rows of the table in Markdown."""
    rows = [
        "| function | " + " | ".join(c.replace("compile", "torch.compile") for c in checks) + " |",
        "|---" * (len(checks) + 1) + "|",
    ]
    for name in names:
        check = Check(every[name])
        entries = [entry(check, c) for c in checks]
        rows.append(f"| `{name}` | " + " | ".join(e.text for e in entries) + " |")
        print(rows[-1], flush=True)
        for c, e in zip(checks, entries):
            if e.message:
                print(f"    {c}: {' '.join(e.message.split())[:300]}", flush=True)
    return rows


INTRODUCTION = """# Derivatives and transforms

The table lists every public function of `sfmkit.geometry`. It is made by

    {command}

with torch {torch}. Each function is checked at one generic point of a noisy scene.

- *gradcheck*, *gradgradcheck*: first and second derivatives agree with finite differences.
- *jacrev*, *jacfwd*: `torch.func.jacrev` and `jacfwd` agree with the derivatives of autograd.
- *vmap*, *batch*: a batch of two agrees with the two single calls.
- *float32*: single-precision input gives single-precision output, within 1 % of double precision.
{compile}
Entries: *yes*; *raises*: torch or sfmkit raises an error; *wrong*: the results differ; *no
derivative*: the output does not depend on the input in a differentiable way; *–*: the function has
no floating-point output; *float64*: the output is always double precision.

The minima (`refine_essential`, `refine_focal`, `refine_homography`, `bundle_adjust`) are
differentiated by the implicit function theorem: the derivative with respect to the start is zero,
and the derivative is that of the exact minimum, not of the iterations.

"""

_COMPILED = f"""- *torch.compile*: one graph without breaks, traced in {_COMPILE_SECONDS} s at most,
  agrees with eager execution.
"""


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--compile", action="store_true", help="fill the last column")
    parser.add_argument("--only", nargs="+", metavar="NAME", help="print the rows of functions")
    args = parser.parse_args()
    warnings.filterwarnings("ignore", message=r"`torch\.jit\.script` is deprecated")
    checks = (*CHECKS, "compile") if args.compile else CHECKS
    rows = table(args.only or public_functions(), checks, cases())
    if not args.only:
        text = INTRODUCTION.format(
            command="python benchmarks/derivatives.py" + " --compile" * args.compile,
            torch=torch.__version__.split("+")[0],
            compile=_COMPILED if args.compile else "",
        )
        PAGE.write_text(text + "\n".join(rows) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
