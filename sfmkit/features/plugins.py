"""The extension point for feature operators: contract, registry, built-in operators."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any, Protocol, TypeVar

import numpy as np

from .._utils.registry import Registry, accepted
from ..errors import OperatorError
from ..types import Features
from .affine import AFFINE, AffineOperator
from .builtin import BuiltInOperator
from .learned import LEARNED, LearnedOperator
from .tables import DESCRIPTORS, DETECTORS, LEFT_OUT, OPERATORS, find_spec

F = TypeVar("F", bound=Callable)
Select = Callable[[np.ndarray, np.ndarray], np.ndarray]
_PARTS = {*DETECTORS, *DESCRIPTORS, *LEFT_OUT}
COMMON = ("grey", "select", "preset", "device")


class Operator(Protocol):
    """A feature operator: a detector with its descriptor.

    A plug-in is a callable ``(image, **options) -> Features``. sfmkit reduces the image to
    ``max_size`` before the call. After the call it rescales the keypoints, drops those outside the
    mask and keeps at most as many as the budget allows. A parameter with one of these names gets
    its value from sfmkit:

    - ``grey``: (H, W) uint8, the image in grey levels;
    - ``select``: function ``(xy, scores) -> rows`` that returns the keypoints within the mask and
      the budget, so that an operator can describe only these; xy (N, 2) are pixels of the image,
      scores (N,);
    - ``preset``: ``default``, ``paper`` or ``dense``;
    - ``device``: torch device on which to compute, or None for the CPU.

    The same input must give the same output.
    """

    def __call__(self, image: np.ndarray, /, **options: Any) -> Features:
        """Find and describe keypoints.

        Args:
            image: (H, W, 3) uint8 RGB; the operator must not modify it.
            options: The operator's own options, given in ``DetectOptions.overrides``.

        Returns:
            Features in pixels of the image, with all keypoints inside it and ``size_wh`` equal to
            (W, H). sfmkit sets the field ``operator``. Without keypoints the arrays are empty.
        """


class OperatorRegistry(Registry[Callable[..., Features]]):
    """The operators; ``detector+descriptor`` and ``affine-NAME`` are composed on demand."""

    def __contains__(self, name: str) -> bool:
        try:
            self[name]
        except OperatorError:
            return False
        return True

    def __getitem__(self, name: str) -> Callable[..., Features]:
        name = self._spelling(name)
        if super().__contains__(name) and not name.startswith(AFFINE):
            return super().__getitem__(name)
        if name.startswith(AFFINE):
            return AffineOperator(self[name.removeprefix(AFFINE)])
        if "+" in name or name in _PARTS:
            return BuiltInOperator(find_spec(name))
        return super().__getitem__(name)

    def canonical(self, name: str) -> str:
        name = self._spelling(name)
        if name.startswith(AFFINE):
            return AFFINE + self.canonical(name.removeprefix(AFFINE))
        plugin = self[name]
        return plugin.spec.name if isinstance(plugin, BuiltInOperator) else name

    def import_path(self, name: str) -> str:
        name = self._spelling(name)
        if name.startswith(AFFINE):
            return AFFINE + self.import_path(name.removeprefix(AFFINE))
        return super().import_path(name)

    def options(self, name: str) -> dict[str, Any]:
        """Return the options of an operator with their defaults.

        Raises:
            OperatorError: The operator is unknown.
        """
        plugin = self[name]
        if isinstance(plugin, (BuiltInOperator, AffineOperator, LearnedOperator)):
            return dict(plugin.options)
        parameters = list(inspect.signature(plugin).parameters.values())[1:]
        return {
            p.name: p.default
            for p in parameters
            if p.name not in COMMON and p.default is not p.empty
        }

    def _code(self, plugin: Callable) -> Callable:
        return self._code(plugin.base) if isinstance(plugin, AffineOperator) else plugin

    def _spelling(self, name: str) -> str:
        """Return the registered spelling; the case of built-in names is ignored."""
        name = str(name).strip()
        return name if super().__contains__(name) else name.lower()


OPERATOR_PLUGINS = OperatorRegistry("operator", "sfmkit.operators", OperatorError)
for _spec in OPERATORS.values():
    OPERATOR_PLUGINS.register(_spec.name, BuiltInOperator(_spec))
for _learned in LEARNED.values():
    OPERATOR_PLUGINS.register(_learned.name, _learned)


def register_operator(name: str, operator: F) -> F:
    """Register an operator under a name, for this process.

    Args:
        name: Name of the operator in ``operators=``, tables, recordings and reports.
        operator: A callable that fulfils the contract of :class:`Operator`.

    Returns:
        `operator`.

    Raises:
        InputError: `operator` is not callable, or the name is malformed or taken.
    """
    OPERATOR_PLUGINS.register(name, operator)
    return operator


def run_operator(
    name: str,
    image: np.ndarray,
    *,
    grey: np.ndarray,
    select: Select,
    preset: str,
    device: Any,
    **options: Any,
) -> Features:
    """Run an operator and check that its result fulfils the contract.

    Args:
        name: Name of the operator.
        image: (H, W, 3) uint8 RGB.
        grey: (H, W) uint8, the image in grey levels.
        select: Function that returns the rows of the keypoints to keep, from positions (N, 2) and
            scores (N,).
        preset, device: Passed to operators with such parameters.
        options: The operator's own options.

    Raises:
        OperatorError: The operator is unknown, fails, or returns an invalid result.
    """
    operator = OPERATOR_PLUGINS[name]
    common = {"grey": grey, "select": select, "preset": preset, "device": device}
    common = accepted(operator, common, rest=False)
    found = OPERATOR_PLUGINS.call(name, image, **common, **options)
    size_wh = image.shape[1], image.shape[0]
    if not isinstance(found, Features):
        raise OPERATOR_PLUGINS.reject(name, found, "it must be Features")
    if tuple(found.size_wh) != size_wh:
        raise OPERATOR_PLUGINS.reject(
            name, found, f"size_wh is {found.size_wh}, the image has {size_wh}"
        )
    xy = found.keypoints
    if len(xy) and not ((xy >= -0.5) & (xy <= np.array(size_wh) - 0.5)).all():
        raise OPERATOR_PLUGINS.reject(name, found, "keypoints lie outside the image")
    if "select" not in common:
        found = found.take(select(found.keypoints, found.scores))
    return found
