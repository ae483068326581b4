"""Tables of detectors, descriptors and operators (named pairs of the two).

:data:`OPERATORS` contains the usual pairs; :func:`find_spec` builds any other
``detector+descriptor`` from :data:`DETECTORS` and :data:`DESCRIPTORS`. Options of OpenCV's
operators have OpenCV's names, so that its manual applies.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from ..errors import OperatorError
from ..types import Norm

Options = Mapping[str, Any]

OPENCV = "Apache-2.0 (OpenCV)"
SIFT_PATENT = "Apache-2.0 (OpenCV); US 6,711,293 expired in March 2020"
SURF_PATENT = (
    "Apache-2.0 (our code); patents US 8,165,401, US 8,670,619, EP 2 027 558 (priority April "
    "2006): check your jurisdiction"
)


@dataclass(frozen=True)
class DetectorSpec:
    """A keypoint detector.

    Attributes:
        create: Name of its factory in ``cv2``; None for an implementation in sfmkit.
        options: Its options with the defaults of sfmkit.
        function: For an implementation in sfmkit, the function ``module:name`` of this package:
            ``(grey, *, device, **options) -> Features``.
        fixed: Options of the factory with a fixed value.
        fast_size: Factor that converts the size of a keypoint to that of FAST (7 pixels for a
            corner at full resolution). Sizes differ between OpenCV's detectors; its descriptors
            assume those of FAST.
        integer: Whether positions are whole pixels, which `subpixel` refines.
        oriented: Whether keypoints have an orientation.
        only_with: The only descriptor that can describe its keypoints; None for any.
        why: The reason for `only_with`.
        min_side: Images with a shorter side have no keypoints (OpenCV fails or crashes on them).
        licence: Licence of the implementation, and patents.
    """

    create: str | None
    options: Options = field(default_factory=dict)
    function: str | None = None
    fixed: Options = field(default_factory=dict)
    fast_size: float = 1.0
    integer: bool = False
    oriented: bool = False
    only_with: str | None = None
    why: str = ""
    min_side: int = 3
    licence: str = OPENCV


@dataclass(frozen=True)
class DescriptorSpec:
    """A keypoint descriptor.

    Attributes:
        create: Name of its factory in ``cv2``; None for an implementation in sfmkit.
        norm: Norm of the distance between two descriptors.
        width: Length in floats (norm l2) or bits (norm hamming), with default options.
        options: Its options with the defaults of sfmkit.
        function: For an implementation in sfmkit, the function ``module:name`` of this package:
            ``(grey, xy, sizes, angles, *, device, **options) -> descriptors``.
        fixed: Options of the factory with a fixed value.
        native: The detector with which it is one operator; by default that of the same name.
        size: Size of the neighbourhood of a descriptor of sfmkit, as a multiple of the FAST size.
        hellinger: Whether descriptors are compared by the Hellinger kernel instead of L2.
        reads_octave: Whether the scale is taken from the keypoint's octave instead of its size.
        reads_missing_angle: Whether an orientation is computed only if the keypoint has none (-1).
        margin: Keypoints closer than this to the border, in pixels, are dropped; 0 if the margin
            depends on their size.
        orients: Whether the descriptor computes the orientation and ignores that of the detector.
        rotates_by: The option that rotates the descriptor by the keypoint's orientation; None if
            it is always rotated.
        only_with: The only detector whose keypoints it can describe; None for any.
        why: The reason for `only_with`.
        licence: Licence of the implementation, and patents.
    """

    create: str | None
    norm: Norm
    width: int
    options: Options = field(default_factory=dict)
    function: str | None = None
    fixed: Options = field(default_factory=dict)
    native: str | None = None
    size: float = 1.0
    hellinger: bool = False
    reads_octave: bool = False
    reads_missing_angle: bool = False
    margin: int = 0
    orients: bool = False
    rotates_by: str | None = None
    only_with: str | None = None
    why: str = ""
    licence: str = OPENCV


@dataclass(frozen=True)
class OperatorSpec:
    """A detector with a descriptor.

    Attributes:
        name: Name in ``detect(image, name)``.
        detector, descriptor: Keys of :data:`DETECTORS` and :data:`DESCRIPTORS`.
        norm: ``l2`` or ``hamming``.
        width: Length of a descriptor in floats or bits, with default options.
        options: Every option with the default of sfmkit.
        paper, dense: Options that replace the defaults in these presets.
        licence: Licence of the implementation, and patents (facts only).
        summary: Description in one line.
    """

    name: str
    detector: str
    descriptor: str
    norm: Norm
    width: int
    options: Options = field(default_factory=dict)
    paper: Options = field(default_factory=dict)
    dense: Options = field(default_factory=dict)
    licence: str = OPENCV
    summary: str = ""

    @property
    def is_pair(self) -> bool:
        """Whether detector and descriptor are separate, run one after the other."""
        return self.detector != (DESCRIPTORS[self.descriptor].native or self.descriptor)


_SIFT: Options = {
    "nfeatures": 0,
    "nOctaveLayers": 3,
    # OpenCV's default of 0.04 finds only 3,800 keypoints in a 6-megapixel photograph.
    "contrastThreshold": 0.01,
    "edgeThreshold": 10.0,
    "sigma": 1.6,
    "enable_precise_upscale": True,  # without it every keypoint is a quarter of a pixel off
}
_GFTT: Options = {"maxCorners": 10_000, "qualityLevel": 1e-3, "minDistance": 3.0, "blockSize": 3}

DETECTORS: Mapping[str, DetectorSpec] = {
    "surf": DetectorSpec(
        None,
        {"hessian_threshold": 30.0, "octaves": 4, "layers": 3, "extended": False, "upright": False},
        function="surf:surf",
        fast_size=1.25,
        oriented=True,
        licence=SURF_PATENT,
    ),
    "orb": DetectorSpec(
        "ORB_create",
        {
            "nfeatures": 35_000,
            "scaleFactor": 1.2,
            "nlevels": 8,
            "edgeThreshold": 31,
            "patchSize": 31,
            "fastThreshold": 7,
        },
        fast_size=7 / 31,
        integer=True,
        oriented=True,
    ),
    "fast": DetectorSpec("FastFeatureDetector_create", {"threshold": 10}, integer=True),
    "agast": DetectorSpec(
        "xfeatures2d.AgastFeatureDetector_create", {"threshold": 10}, integer=True
    ),
    "harris": DetectorSpec(
        "GFTTDetector_create",
        # The response is of fourth order in the gradient, hence a smaller qualityLevel.
        {**_GFTT, "qualityLevel": 1e-4, "k": 0.04},
        fixed={"useHarrisDetector": True},
        fast_size=7 / 3,
        integer=True,
    ),
    "gftt": DetectorSpec("GFTTDetector_create", _GFTT, fast_size=7 / 3, integer=True),
    "sift": DetectorSpec("SIFT_create", _SIFT, fast_size=1.35, oriented=True, licence=SIFT_PATENT),
    "akaze": DetectorSpec(
        "xfeatures2d.AKAZE_create",
        {"threshold": 1e-4, "nOctaves": 4, "nOctaveLayers": 4},
        oriented=True,
    ),
    "kaze": DetectorSpec(
        "xfeatures2d.KAZE_create",
        {"threshold": 1e-4, "nOctaves": 4, "nOctaveLayers": 4, "extended": False, "upright": False},
        fast_size=1.25,
        oriented=True,
    ),
    "brisk": DetectorSpec(
        "xfeatures2d.BRISK_create",
        {"thresh": 30, "octaves": 3, "patternScale": 1.0},
        oriented=True,
        min_side=8,
    ),
    "star": DetectorSpec(
        "xfeatures2d.StarDetector_create",
        {
            "maxSize": 45,
            "responseThreshold": 10,
            "lineThresholdProjected": 10,
            "lineThresholdBinarized": 8,
            "suppressNonmaxSize": 5,
        },
        min_side=8,
    ),
    "mser": DetectorSpec(
        "MSER_create",
        {
            "delta": 5,
            "min_area": 60,
            "max_area": 14_400,
            "max_variation": 0.25,
            "min_diversity": 0.2,
        },
    ),
}

# The options for the minimum strength and the maximum number of keypoints: the preset ``dense``
# halves the former and doubles the latter.
FAINTEST: Mapping[str, str] = {
    "surf": "hessian_threshold",
    "orb": "fastThreshold",
    "fast": "threshold",
    "agast": "threshold",
    "harris": "qualityLevel",
    "gftt": "qualityLevel",
    "sift": "contrastThreshold",
    "akaze": "threshold",
    "kaze": "threshold",
    "brisk": "thresh",
    "star": "responseThreshold",
}
MOST: Mapping[str, str] = {
    "orb": "nfeatures",
    "harris": "maxCorners",
    "gftt": "maxCorners",
}

_LEVELS = "it reads scale levels that only its own detector computes"

DESCRIPTORS: Mapping[str, DescriptorSpec] = {
    "surf": DescriptorSpec(
        None,
        "l2",
        64,
        {"extended": False},
        function="surf:describe",
        # OpenCV's descriptors cover 5 times the size of FAST, and SURF's size is 1/1.25 of it. On
        # other detectors' keypoints, slightly more than SURF's own neighbourhood is best.
        size=2.5,
        licence=SURF_PATENT,
    ),
    "orb": DescriptorSpec("ORB_create", "hamming", 256, reads_octave=True, margin=31),
    "brief": DescriptorSpec(
        "xfeatures2d.BriefDescriptorExtractor_create",
        "hamming",
        256,
        {"bytes": 32, "use_orientation": False},
        margin=28,
        rotates_by="use_orientation",
    ),
    "sift": DescriptorSpec("SIFT_create", "l2", 128, licence=SIFT_PATENT),
    "rootsift": DescriptorSpec(
        "SIFT_create", "l2", 128, native="sift", hellinger=True, licence=SIFT_PATENT
    ),
    "brisk": DescriptorSpec(
        "xfeatures2d.BRISK_create",
        "hamming",
        512,
        {"patternScale": 1.0},
        fixed={"thresh": 30, "octaves": 3},
        reads_missing_angle=True,
        orients=True,
    ),
    "freak": DescriptorSpec(
        "xfeatures2d.FREAK_create",
        "hamming",
        512,
        {
            "orientationNormalized": True,
            "scaleNormalized": True,
            "patternScale": 22.0,
            "nOctaves": 4,
        },
        orients=True,
    ),
    "latch": DescriptorSpec(
        "xfeatures2d.LATCH_create",
        "hamming",
        256,
        {"bytes": 32, "rotationInvariance": True, "half_ssd_size": 3, "sigma": 2.0},
        margin=24,
    ),
    # Patch sides are multiples of the size of FAST; see DetectorSpec.fast_size.
    "beblid": DescriptorSpec("xfeatures2d.BEBLID_create", "hamming", 512, {"scale_factor": 5.0}),
    "teblid": DescriptorSpec("xfeatures2d.TEBLID_create", "hamming", 256, {"scale_factor": 5.0}),
    "boost": DescriptorSpec("xfeatures2d.BoostDesc_create", "hamming", 256, {"scale_factor": 5.0}),
    "daisy": DescriptorSpec(
        "xfeatures2d.DAISY_create",
        "l2",
        200,
        {"radius": 15.0, "q_radius": 3, "q_theta": 8, "q_hist": 8, "use_orientation": False},
        rotates_by="use_orientation",
    ),
    "vgg": DescriptorSpec(
        "xfeatures2d.VGG_create", "l2", 120, {"isigma": 1.4, "scale_factor": 5.0}
    ),
    "akaze": DescriptorSpec(
        "xfeatures2d.AKAZE_create", "hamming", 488, only_with="akaze", why=_LEVELS
    ),
    "kaze": DescriptorSpec("xfeatures2d.KAZE_create", "l2", 64, only_with="kaze", why=_LEVELS),
}

# Detectors and descriptors of cv2 that are not supported, and the reasons, for the error message.
LEFT_OUT: Mapping[str, str] = {
    "lucid": "it needs a colour image, and neither norm can compare its ranks of bytes",
    "msd": "OpenCV's implementation crashes on small images",
    "harris-laplace": "the positions of OpenCV's implementation are wrong by half a pixel",
    "tbmr": "OpenCV's implementation has no response, and its orientations have another unit",
}


def _pair(detector: str, descriptor: str, name: str, summary: str) -> OperatorSpec:
    """Combine two rows into an operator; the detector's option has precedence."""
    where, what = DETECTORS[detector], DESCRIPTORS[descriptor]
    native = detector == (what.native or descriptor)
    options = dict(where.options) if native else {**what.options, **where.options}
    paper = {}
    dense = {MOST[detector]: 2 * options[MOST[detector]]} if detector in MOST else {}
    if detector in FAINTEST:
        least = options[FAINTEST[detector]]
        dense[FAINTEST[detector]] = (least + 1) // 2 if isinstance(least, int) else least / 2
    if where.integer:
        options["subpixel"], paper["subpixel"] = True, False
    if not (where.oriented or what.orients or native):
        options["oriented"] = False
    licences = dict.fromkeys((where.licence, what.licence))
    if len(licences) > 1:
        licences.pop(OPENCV, None)
    return OperatorSpec(
        name,
        detector,
        descriptor,
        what.norm,
        what.width,
        options,
        paper,
        dense,
        "; ".join(licences),
        summary,
    )


OPERATORS: Mapping[str, OperatorSpec] = {
    spec.name: spec
    for spec in (
        _pair(
            "surf",
            "surf",
            "surf",
            "blobs of the determinant of the Hessian, box filters (Bay et al. 2008)",
        ),
        _pair(
            "orb",
            "orb",
            "orb",
            "oriented FAST corners on a pyramid, rotated BRIEF (Rublee et al. 2011)",
        ),
        _pair(
            "fast",
            "brief",
            "fast-brief",
            "FAST corners (Rosten & Drummond 2006), BRIEF bits (Calonder et al. 2010)",
        ),
        _pair(
            "sift",
            "sift",
            "sift",
            "blobs of the difference of Gaussians, gradient histograms (Lowe 2004)",
        ),
        _pair(
            "sift",
            "rootsift",
            "rootsift",
            "SIFT compared by the Hellinger kernel (Arandjelovic & Zisserman 2012)",
        ),
        _pair(
            "akaze",
            "akaze",
            "akaze",
            "blobs of a fast non-linear scale space, bits (Alcantarilla et al. 2013)",
        ),
        _pair(
            "kaze", "kaze", "kaze", "blobs of a non-linear scale space (Alcantarilla et al. 2012)"
        ),
        _pair(
            "brisk",
            "brisk",
            "brisk",
            "AGAST corners in scale space, ring pattern bits (Leutenegger et al. 2011)",
        ),
        _pair(
            "harris", "brief", "harris-brief", "Harris corners (Harris & Stephens 1988), BRIEF bits"
        ),
        _pair(
            "gftt",
            "brief",
            "gftt-brief",
            "corners of the smaller eigenvalue (Shi & Tomasi 1994), BRIEF bits",
        ),
    )
}


def find_spec(name: str) -> OperatorSpec:
    """Find the named operator, or build the pair ``detector+descriptor``.

    Raises:
        OperatorError: The name is unknown (the message suggests the most similar name), or the pair
            is incompatible.
    """
    name = str(name).strip().lower()
    if name in OPERATORS:
        return OPERATORS[name]
    detector, plus, descriptor = (part.strip() for part in name.partition("+"))
    if not plus:
        if name in LEFT_OUT:
            raise OperatorError(f"operator '{name}' is left out: {LEFT_OUT[name]}")
        if name in DETECTORS or name in DESCRIPTORS:
            example = f"{name}+brief" if name in DETECTORS else f"fast+{name}"
            kind = "detector" if name in DETECTORS else "descriptor"
            raise OperatorError(
                f"'{name}' is a {kind} only; pair it as detector+descriptor, e.g. '{example}'"
            )
        raise OperatorError.unknown(name, OPERATORS)
    for part, kind, table in (
        (detector, "detector", DETECTORS),
        (descriptor, "descriptor", DESCRIPTORS),
    ):
        if part in LEFT_OUT:
            raise OperatorError(f"'{part}' is left out: {LEFT_OUT[part]}")
        if part not in table:
            raise OperatorError(
                f"unknown {kind} '{part}' in '{name}'. Known: {', '.join(sorted(table))}"
            )
    where, what = DETECTORS[detector], DESCRIPTORS[descriptor]
    if what.only_with not in (None, detector):
        raise OperatorError(
            f"'{name}' does not fit: {descriptor} describes {what.only_with} keypoints only, "
            f"because {what.why}"
        )
    if where.only_with not in (None, descriptor):
        raise OperatorError(f"'{name}' does not fit: {where.why}")
    for spec in OPERATORS.values():
        if (spec.detector, spec.descriptor) == (detector, descriptor):
            return spec
    return _pair(
        detector,
        descriptor,
        f"{detector}+{descriptor}",
        f"{detector} keypoints, {descriptor} descriptors",
    )
