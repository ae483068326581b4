"""Plan of the work on a folder: its pairs, and the recipe for each pair."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from .._utils.sharding import Shard, part_bounds
from ..ablation.plan import cost
from ..ablation.plugins import ESTIMATOR, MATCHER, OPERATOR, REGISTRIES, PlugIn, find_plugin
from ..ablation.tasks import DetectTask, ImageRef, MatchTask, PairTask
from ..ablation.variants import Setting
from ..errors import InputError
from ..estimation import check_estimator
from ..features import choose_operators
from ..matching import canonical_matchers, choose_matchers, matcher_of
from ..options import DEFAULT, Options
from ..types import MAX_OPERATORS
from .collection import Collection
from .retrieval import BUDGET, MAX_SIZE
from .shared_cameras import SharedCameras

__all__ = ["FolderPlan", "Recipe", "make_recipe"]

_NO_IMAGE = ""  # digest of a reference that contains only the size


@dataclass(frozen=True)
class Recipe:
    """Operators, options and plug-ins for all photographs and pairs.

    Attributes:
        operators: Operators in the order of the bits of masks.
        options: Options of all stages.
        plugins: Plug-ins by kind and name.
        descriptor: Operator whose features determine the similarity of photographs.
        seed: Seed of the robust estimation.
    """

    operators: tuple[str, ...]
    options: Options
    plugins: Mapping[tuple[str, str], PlugIn]
    descriptor: str = "sift"
    seed: int = 0

    @property
    def foreign_plugins(self) -> tuple[PlugIn, ...]:
        """The plug-ins outside sfmkit, which workers have to load."""
        return tuple(p for p in self.plugins.values() if not REGISTRIES[p.kind].is_built_in(p.name))

    def detection(self, image: ImageRef, operator: str) -> DetectTask:
        detect = self.options.detect
        own = tuple(sorted(detect.overrides.get(operator, {}).items()))
        setting = Setting(operator, detect.preset, detect.budget, detect.max_size, own)
        return DetectTask(image, setting, self.plugins[OPERATOR, operator].code)

    def overview(self, image: ImageRef) -> DetectTask:
        """Make the task that detects few features for the comparison of photographs."""
        setting = Setting(self.descriptor, "default", BUDGET, MAX_SIZE)
        return DetectTask(image, setting, self.plugins[OPERATOR, self.descriptor].code)

    def matching(self, first: ImageRef, second: ImageRef, operator: str) -> MatchTask:
        match = self.options.match
        code = self.plugins[MATCHER, matcher_of(operator, match)].code
        return MatchTask(
            self.detection(first, operator), self.detection(second, operator), match, code
        )

    def as_json(self) -> dict[str, Any]:
        """Return the recipe as JSON values for reports."""
        from ..options import as_plain

        return {
            "operators": list(self.operators),
            "options": as_plain(self.options),
            "plugins": {f"{p.kind} {p.name}": p.code for p in self.plugins.values()},
            "seed": self.seed,
        }


@dataclass(frozen=True, eq=False)
class FolderPlan:
    """The pairs of a folder with cameras and recipe.

    Attributes:
        collection: The photographs.
        cameras: Cameras of the photographs.
        recipe: Operators, options and plug-ins.
        rules: Rules by which the pairs were chosen, as text.
        pairs: (P, 2) int64 indices of photographs, i < j.
    """

    collection: Collection
    cameras: SharedCameras
    recipe: Recipe
    rules: str
    pairs: np.ndarray

    def __len__(self) -> int:
        return len(self.pairs)

    def task(self, row: int) -> PairTask:
        """Make the task of a pair. The first use of a photograph hashes its bytes."""
        i, j = (int(k) for k in self.pairs[row])
        first, second = self.collection.ref(i), self.collection.ref(j)
        masks = (self.collection.mask_ref(i), self.collection.mask_ref(j))
        return self._task(first, second, (i, j), masks)

    def _task(
        self,
        first: ImageRef,
        second: ImageRef,
        pair: tuple[int, int],
        masks: tuple[ImageRef | None, ImageRef | None],
    ) -> PairTask:
        recipe = self.recipe
        estimate = recipe.options.estimate
        return PairTask(
            {name: recipe.matching(first, second, name) for name in recipe.operators},
            (self.cameras[pair[0]], self.cameras[pair[1]]),
            masks,
            recipe.options.fuse,
            estimate,
            recipe.plugins[ESTIMATOR, estimate.backend].code,
            recipe.seed,
        )

    def detection(self, photograph: int, operator: str) -> DetectTask:
        """Make the task that detects the features of an operator in a photograph."""
        return self.recipe.detection(self.collection.ref(photograph), operator)

    @cached_property
    def used(self) -> np.ndarray:
        """The photographs that occur in a pair, sorted."""
        return np.unique(self.pairs)

    def seconds(self) -> float:
        """Estimate the duration of all tasks on one thread, without reading files."""
        bare = [ImageRef(_NO_IMAGE, "", p.size_wh) for p in self.collection.photographs]
        total = sum(
            cost(self.recipe.detection(bare[k], name))
            for k in self.used
            for name in self.recipe.operators
        )
        by_sizes: dict[Any, float] = {}
        for i, j in self.pairs.tolist():
            sizes = (bare[i].size_wh, bare[j].size_wh)
            if sizes not in by_sizes:
                by_sizes[sizes] = cost(self._task(bare[i], bare[j], (i, j), (None, None)))
            total += by_sizes[sizes]
        return total

    def part(self, shard: Shard | None) -> FolderPlan:
        """Return the plan of a shard, see :func:`sfmkit._utils.sharding.part_bounds`."""
        return replace(self, pairs=self.pairs[part_bounds(len(self), shard)])


def make_recipe(
    operators: Sequence[str],
    *,
    options: Options = DEFAULT,
    matchers: str | Mapping[str, str] | None = None,
    descriptor: str = "sift",
    seed: int = 0,
) -> Recipe:
    """Check operators, matchers and options, and find their plug-ins.

    Args:
        operators, matchers: Names or import paths, as for :func:`sfmkit.reconstruct`.
        options: Options of all stages.
        descriptor: Operator whose features determine the similarity of photographs.
        seed: Seed of the robust estimation.

    Raises:
        InputError: An operator, matcher or estimator is unknown or cannot be used, or `seed` is out
            of range.
    """
    names = choose_operators(operators)
    if len(names) > MAX_OPERATORS:
        raise InputError(f"at most {MAX_OPERATORS} operators can be fused, not {len(names)}")
    (descriptor,) = choose_operators([descriptor])
    if not 0 <= seed < 2**31:
        raise InputError(f"seed must be from 0 to 2^31 - 1, not {seed}")
    match = choose_matchers(options.match, canonical_matchers(matchers))
    unused = [name for name in match.matchers if name not in names]
    if unused:
        raise InputError(f"a matcher for operators that are not used: {', '.join(unused)}")
    options = replace(options, match=match)
    estimate = options.estimate
    check_estimator(
        estimate.backend,
        model=estimate.model,
        method=estimate.method,
        overrides=estimate.overrides,
    )
    wanted = [(OPERATOR, name) for name in (*names, descriptor)]
    wanted += [(MATCHER, matcher_of(name, match)) for name in names]
    wanted.append((ESTIMATOR, options.estimate.backend))
    plugins = {key: find_plugin(*key) for key in dict.fromkeys(wanted)}
    return Recipe(names, options, plugins, descriptor, seed)
