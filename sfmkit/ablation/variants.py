"""Combinations of operators, presets, and varied settings of operators and stages."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import combinations, product
from typing import Any

from ..errors import InputError
from ..features import OPERATOR_PLUGINS
from ..matching import choose_matchers
from ..options import PRESETS, DetectOptions, Options, PlanarOptions

UNKNOWN = object()  # differs from every value
JOIN = "/"  # between the operators of a combination; + already joins a detector with a descriptor
MAX_OPERATORS = 12  # 4,095 combinations

Combination = tuple[str, ...]

# setting of a stage -> the options that hold it
STAGE_SETTINGS: Mapping[str, str] = {
    "budget": "detect",
    "max_size": "detect",
    "max_ratio": "match",
    "max_distance": "match",
    "mutual": "match",
    "matcher": "match",
    "merge_radius": "fuse",
    "threshold_px": "estimate",
    "model": "estimate",
    "backend": "estimate",
    "confidence": "estimate",
    "max_iterations": "estimate",
}
NOT_PLANAR = ("model", "backend", "confidence", "max_iterations")  # no effect on homographies
MATCHER = "matcher"  # OPERATOR.matcher is the matcher of one operator


def choose_combinations(
    operators: Sequence[str], combos: str | Sequence[str | Sequence[str]] = "all"
) -> list[Combination]:
    """Choose the combinations to run, each in the order of `operators`, small ones first.

    Args:
        operators: Names, in the order that is used everywhere.
        combos: ``all`` (every non-empty subset), ``pairs`` (single operators and every two),
            ``leave-one-out`` (all together, all but one, and each alone), or a list:
            ``surf/orb,sift`` as text, or a sequence of such combinations.

    Raises:
        InputError: Operators are unknown or too many for ``all``, or the list is malformed.
    """
    if not operators:
        raise InputError("name at least one operator, e.g. surf,orb,sift")
    n = len(operators)
    if combos in ("all", "pairs", "leave-one-out"):
        if combos == "all" and n > MAX_OPERATORS:
            raise InputError(
                f"{n} operators have {2**n - 1:,} combinations; choose pairs, leave-one-out or a "
                "list"
            )
        sizes = {"all": range(1, n + 1), "pairs": (1, 2), "leave-one-out": (1, n - 1, n)}[
            str(combos)
        ]
        found = [c for size in sizes for c in combinations(operators, size)]
    else:
        parts = combos.split(",") if isinstance(combos, str) else combos
        found = [_combination(part, operators) for part in parts if part]
    found = sorted(
        dict.fromkeys(c for c in found if c),
        key=lambda c: (len(c), [operators.index(o) for o in c]),
    )
    if not found:
        raise InputError(
            f"no combination in {combos!r}; use all, pairs, leave-one-out, or a list such as "
            "surf/orb,sift"
        )
    return found


def _combination(part: str | Sequence[str], operators: Sequence[str]) -> Combination:
    names = part.split(JOIN) if isinstance(part, str) else part
    members = {OPERATOR_PLUGINS.canonical(name) for name in names}
    for name in members:
        if name not in operators:
            raise InputError(
                f"the combination {JOIN.join(names)} has an operator '{name}' that is not among "
                "--operators; the choices "
                f"all, pairs and leave-one-out cannot be part of a list"
            )
    return tuple(o for o in operators if o in members)


@dataclass(frozen=True)
class Setting:
    """How one operator is run on an image.

    Attributes:
        operator: Its name.
        preset, budget, max_size, options: As in :func:`sfmkit.features.detect`.
    """

    operator: str
    preset: str
    budget: int | None
    max_size: int | None
    options: tuple[tuple[str, Any], ...] = ()

    def as_json(self) -> list[Any]:
        return [
            self.operator,
            self.preset,
            self.budget,
            self.max_size,
            [list(o) for o in self.options],
        ]


@dataclass(frozen=True)
class Variant:
    """A preset with some settings changed.

    Attributes:
        preset: ``default``, ``dense`` or ``paper``.
        changes: (name, value); a name is the setting of a stage or ``operator.option``.
    """

    preset: str
    changes: tuple[tuple[str, Any], ...] = ()

    def of(self, combination: Combination, homography: bool) -> Variant:
        """Remove the changes without effect on a combination and kind of estimate.

        These are changes to operators that are not in the combination, to settings of the other
        kind of estimate, and to the value that the preset has.
        """

        def counts(change: tuple[str, Any]) -> bool:
            name, value = change
            if name.rpartition(".")[0] not in ("", *combination):
                return False
            if homography and name in NOT_PLANAR:
                return False
            return value != self._default(name, homography)

        return replace(self, changes=tuple(filter(counts, self.changes)))

    def _default(self, name: str, homography: bool) -> Any:
        """The preset's value of a setting; :data:`UNKNOWN` where it depends on the operator."""
        options = PRESETS[self.preset]
        owner, _, option = name.rpartition(".")
        if owner and option == MATCHER:
            # the matcher of all operators may be changed too, so this one may not be the default
            changed = any(n == MATCHER for n, _ in self.changes)
            return UNKNOWN if changed else options.match.matcher
        if owner:
            known = self.preset == "default"
            return OPERATOR_PLUGINS.options(owner).get(option) if known else UNKNOWN
        if homography and name == "threshold_px":
            return options.planar.threshold_px
        return getattr(getattr(options, STAGE_SETTINGS[name]), name)

    @property
    def vary(self) -> str:
        """The changes as JSON."""
        return json.dumps(dict(self.changes))

    @property
    def options(self) -> Options:
        return _options(self)

    @property
    def planar(self) -> PlanarOptions:
        """The options of homographies: a changed threshold_px is theirs too."""
        planar = self.options.planar
        changes = dict(self.changes)
        if "threshold_px" in changes:
            planar = replace(planar, threshold_px=changes["threshold_px"])
        return planar

    def setting(self, operator: str) -> Setting:
        detect: DetectOptions = self.options.detect
        mine = dict(detect.overrides.get(operator, {}))
        for name, value in self.changes:
            owner, _, option = name.rpartition(".")
            if owner == operator and option != MATCHER:
                mine[option] = value
        return Setting(
            operator, detect.preset, detect.budget, detect.max_size, tuple(sorted(mine.items()))
        )


@cache
def _options(variant: Variant) -> Options:
    options = PRESETS[variant.preset]
    for name, value in variant.changes:
        owner, _, option = name.rpartition(".")
        if name == "backend":
            options = replace(options, estimate=options.estimate.with_backend(value))
        elif not owner:
            stage = STAGE_SETTINGS[name]
            options = replace(options, **{stage: replace(getattr(options, stage), **{name: value})})
        elif option == MATCHER:
            options = replace(options, match=choose_matchers(options.match, {owner: value}))
    return options


def choose_variants(
    presets: Sequence[str], vary: Mapping[str, Sequence[Any]] | None, operators: Sequence[str]
) -> list[Variant]:
    """Combine every preset with every combination of the varied values.

    Args:
        presets: ``default``, ``dense``, ``paper``, in upper or lower case.
        vary: Name -> values. A name is the setting of a stage (:data:`STAGE_SETTINGS`),
            ``operator.option``, or a prefix that is unique: ``hessian`` for
            ``surf.hessian_threshold``.

    Raises:
        InputError: A preset is unknown, a name is unknown or ambiguous, or there are no values or
            values of another type.
    """
    chosen = list(dict.fromkeys(str(p).strip().lower() for p in presets))
    for preset in chosen:
        if preset not in PRESETS:
            raise InputError(f"unknown preset '{preset}'; there are {', '.join(PRESETS)}")
    if not chosen:
        raise InputError(f"name a preset: {', '.join(PRESETS)}")
    defaults = _settings_with_defaults(operators)
    axes = []
    for word, values in (vary or {}).items():
        name = _resolve(word, defaults)
        if isinstance(values, str) or not len(tuple(values)):
            raise InputError(f"--vary {word}: give at least one value, e.g. {word}=30,100")
        axes.append(
            [(name, _typed(name, value, defaults[name])) for value in dict.fromkeys(values)]
        )
    return [Variant(preset, changes) for preset in chosen for changes in product(*axes)]


def parse_vary(texts: Sequence[str]) -> dict[str, list[str]]:
    """Parse ``["hessian=30,100"]`` as ``{"hessian": ["30", "100"]}``."""
    found: dict[str, list[str]] = {}
    for text in texts:
        name, equals, values = text.partition("=")
        if not equals or not name.strip():
            raise InputError(f"--vary takes NAME=VALUE,VALUE,..., not {text!r}")
        found[name.strip()] = [v.strip() for v in values.split(",") if v.strip()]
    return found


def _settings_with_defaults(operators: Sequence[str]) -> dict[str, Any]:
    stage = {
        name: getattr(getattr(PRESETS["default"], group), name)
        for name, group in STAGE_SETTINGS.items()
    }
    matcher = PRESETS["default"].match.matcher
    return stage | {
        f"{o}.{option}": value
        for o in operators
        for option, value in (OPERATOR_PLUGINS.options(o) | {MATCHER: matcher}).items()
    }


def _resolve(word: str, defaults: Mapping[str, Any]) -> str:
    if word in defaults:
        return word
    near = [
        name
        for name in defaults
        if name.startswith(word) or name.rpartition(".")[2].startswith(word)
    ]
    if len(near) == 1:
        return near[0]
    what = f"can be {', '.join(near)}" if near else f"is not one of {', '.join(defaults)}"
    raise InputError(f"--vary {word}: the name {what}")


def _typed(name: str, value: Any, default: Any) -> Any:
    """Convert `value`, which may be text, to the type of the setting; ``none`` becomes None."""
    text = str(value).strip().lower()
    if text in ("none", "null"):
        return None
    if isinstance(default, bool):
        if text not in ("true", "false", "on", "off"):
            raise InputError(f"--vary {name}: {value!r} is not true or false")
        return text in ("true", "on")
    if isinstance(default, str):
        return str(value).strip()
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise InputError(f"--vary {name}: {value!r} is not a number") from None
    whole = isinstance(default, int) or name == "max_size"
    if whole and number != int(number):
        raise InputError(f"--vary {name}: {value!r} is not a whole number")
    return int(number) if whole else number
