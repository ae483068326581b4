"""The extension point of feature operators: contract, registry and the built-in operators."""

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
    ``max_size`` before the call; afterwards it rescales the keypoints, drops those outside the mask
    and keeps the number that the budget allows. An operator with a parameter of one of these names
    gets it in addition to its own options:

    - ``grey``: (H, W) uint8, the image in grey levels, which sfmkit has computed anyway;
    - ``select``: function ``(xy, scores) -> rows`` of the keypoints that mask and budget leave, for
      an operator that describes only those; xy (N, 2) pixels of the image, scores (N,);
    - ``preset``: ``default``, ``paper`` or ``dense``;
    - ``device``: torch device on which to compute, or None for the CPU.

    The same input must give the same output.
    """

    def __call__(self, image: np.ndarray, /, **options: Any) -> Features:
        """Find and describe keypoints.

        Args:
            image: (H, W, 3) uint8 RGB; it must not be changed.
            options: The operator's own options, given in ``DetectOptions.overrides``.

        Returns:
            Features of the image, keypoints in its pixels and inside it, ``size_wh`` (W, H). The
            field ``operator`` is set by sfmkit. An image without keypoints gives empty arrays.
        """


class OperatorRegistry(Registry[Callable[..., Features]]):
    """Operators by name; ``detector+descriptor`` and ``affine-NAME`` are composed on demand."""

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
        """The options of an operator with their defaults.

        Raises:
            OperatorError: there is no such operator.
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
        """Built-in names are found whatever their case."""
        name = str(name).strip()
        return name if super().__contains__(name) else name.lower()


OPERATOR_PLUGINS = OperatorRegistry("operator", "sfmkit.operators", OperatorError)
for _spec in OPERATORS.values():
    OPERATOR_PLUGINS.register(_spec.name, BuiltInOperator(_spec))
for _learned in LEARNED.values():
    OPERATOR_PLUGINS.register(_learned.name, _learned)


def register_operator(name: str, operator: F) -> F:
    """Make an operator available under a name everywhere that operators are named.

    Args:
        name: What the operator is called in ``operators=``, tables, recordings and reports.
        operator: A callable that obeys the contract of :class:`Operator`.

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
    """Run an operator and check that its result obeys the contract.

    Args:
        name: Of an operator.
        image: (H, W, 3) uint8 RGB.
        grey: (H, W) uint8, the same in grey levels.
        select: Rows of the keypoints to keep, from positions (N, 2) and scores (N,).
        preset, device: Passed to operators that take them.
        options: The operator's own.

    Raises:
        OperatorError: there is no such operator, it failed, or its result is wrong.
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
