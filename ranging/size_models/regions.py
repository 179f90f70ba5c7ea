"""Sizes of road users by region: the middle level of class -> region -> drive -> object.

    log size of an object = class and region  +  drive         +  body type  +  object
                            mean_r               N(0, drive^2)     fractions_r   N(0, sigma^2)

The packaged priors were fitted to KITTI's labels, from Germany. Other populations have other
fractions of the same body types. A drive deviates from its region by `_DRIVE_SIGMA`, as data sets
of one region do, since streets and the people who draw boxes differ. In an unknown region, the
deviation of the regions from their mean is added.

Cars and people have one Gaussian with the moments of the mixture, in whose covariance the aspect
ratio of a box depends on its type; other classes keep the types as components (`SizePrior.bodies`),
whose heights differ more.

Sizes are sizes of frequent models, from their manufacturers. Fractions in North America: EPA,
Automotive Trends Report (production by type, model years 2008 to 2018), which covers vehicles up to
8,500 lb. Heavier pickups: Davis and Truett, Sales and Impact of Class 2b Trucks, TRR 1842, 2003
(7.8 % of the trucks up to 10,000 lb on the road, 82 % of them pickups). Vans: sales of 2014 to 2018
(about 2.5 % of light vehicles; 23 % of them small, half of the others of the European type, of
which two thirds have a medium or high roof). In East Asia: our estimate from sales of Japan, China
and Singapore. Heights of people: NCD-RisC, A century of trends in adult human height, eLife 2016,
with shoes and some children.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.ranging.size_models.cuboid_sizes import CuboidSizes
from track_range.ranging.size_models.prior import BodyType, SizePrior
from track_range.ranging.size_models.region import Region


class _Type(NamedTuple):
    """Sizes of the models of a body type: height, width, length in m, and their relative standard
    deviations.
    """

    hwl_m: tuple[float, float, float]
    log_sigma: tuple[float, float, float]


_TYPES: Mapping[str, Mapping[str, _Type]] = {  # body types of the classes
    "car": {
        # Corolla, Golf, Camry; also estates
        "saloon": _Type((1.46, 1.79, 4.50), (0.035, 0.04, 0.08)),
        "SUV": _Type((1.70, 1.86, 4.60), (0.05, 0.05, 0.07)),  # RAV4, CR-V, Explorer
        "large SUV": _Type((1.92, 2.05, 5.40), (0.03, 0.02, 0.06)),  # Tahoe, Suburban, Expedition
        "pickup": _Type((1.88, 2.00, 5.70), (0.04, 0.04, 0.06)),  # F-150, Silverado, Tacoma
        "heavy pickup": _Type((2.03, 2.05, 6.15), (0.03, 0.03, 0.06)),  # F-250, Silverado 2500
        "minivan": _Type((1.82, 1.92, 5.00), (0.06, 0.06, 0.06)),  # Sienna, Odyssey, Alphard
        "kei car": _Type((1.68, 1.475, 3.395), (0.07, 0.01, 0.01)),  # N-Box, Wagon R
    },
    "van": {  # which detectors call cars
        "small": _Type((1.87, 1.80, 4.70), (0.04, 0.03, 0.05)),  # Transit Connect, NV200
        "full-size": _Type((2.12, 2.03, 5.80), (0.04, 0.03, 0.07)),  # Express, low-roof Transit
        # Transit, ProMaster and Sprinter with a medium or high roof
        "high roof": _Type((2.58, 2.05, 6.10), (0.08, 0.03, 0.09)),
    },
    "person": {
        "American": _Type((1.72, 0.58, 0.72), (0.07, 0.19, 0.33)),
        "Asian": _Type((1.66, 0.56, 0.70), (0.07, 0.19, 0.33)),
    },
    "bicycle": {
        "with rider": _Type((1.735, 0.646, 1.748), (0.0516, 0.2214, 0.0839)),
        "without rider": _Type((1.08, 0.58, 1.70), (0.10, 0.20, 0.08)),
    },
    "motorcycle": {
        "with rider": _Type((1.60, 0.80, 2.10), (0.09, 0.20, 0.12)),
        "without rider": _Type((1.18, 0.78, 2.05), (0.09, 0.15, 0.12)),
    },
    "truck": {
        "pickup": _Type((1.88, 2.00, 5.70), (0.05, 0.05, 0.07)),
        # up to 3.5 t, with a box or platform
        "light": _Type((2.60, 2.10, 6.00), (0.12, 0.08, 0.15)),
        "heavy": _Type((3.45, 2.52, 9.50), (0.10, 0.07, 0.26)),  # 7.5 to 40 t
        "semi-trailer": _Type((4.05, 2.60, 16.5), (0.04, 0.03, 0.15)),  # 13 ft 6 in
    },
    "bus": {
        "single deck": _Type((3.10, 2.52, 11.5), (0.07, 0.05, 0.15)),  # also trams
        "minibus": _Type((2.65, 2.10, 6.80), (0.07, 0.06, 0.12)),
        "coach": _Type((3.65, 2.55, 12.5), (0.05, 0.03, 0.10)),
        "double deck": _Type((4.35, 2.53, 11.5), (0.03, 0.03, 0.08)),
    },
}
_TWO_WHEELERS = {
    "bicycle": {"with rider": 0.75, "without rider": 0.25},
    "motorcycle": {"with rider": 0.6, "without rider": 0.4},
}
# by region and class; missing = the packaged prior
_FRACTIONS: Mapping[Region, Mapping[str, Mapping[str, float]]] = {
    "europe": {
        **_TWO_WHEELERS,
        "bus": {"single deck": 0.7, "minibus": 0.1, "coach": 0.2},
    },
    "north-america": {
        **_TWO_WHEELERS,
        "car": {
            "saloon": 0.46,
            "SUV": 0.3,
            "large SUV": 0.03,
            "pickup": 0.12,
            "heavy pickup": 0.04,
            "minivan": 0.05,
        },
        "van": {"small": 0.2, "full-size": 0.5, "high roof": 0.3},
        "person": {"American": 1.0},
        "truck": {"pickup": 0.35, "light": 0.2, "heavy": 0.2, "semi-trailer": 0.25},
        "bus": {"single deck": 0.75, "minibus": 0.1, "coach": 0.15},
    },
    "east-asia": {
        **_TWO_WHEELERS,
        "car": {"saloon": 0.55, "SUV": 0.25, "minivan": 0.12, "kei car": 0.08},
        "person": {"Asian": 1.0},
        "truck": {"pickup": 0.05, "light": 0.5, "heavy": 0.45},
        "bus": {"single deck": 0.6, "minibus": 0.2, "double deck": 0.2},
    },
}
_DRIVE_SIGMA: Mapping[Region, Mapping[str, float]] = {
    "europe": {"car": 0.045, "person": 0.05},
    "north-america": {"car": 0.06, "person": 0.05},
    "east-asia": {"car": 0.06, "person": 0.05},
}
"""Standard deviation of the log size of all objects of a class in a drive about their region. Mean
heights of cars in data sets of North America are 1.60 (TuSimple), 1.71 (Lyft L5), 1.77 (Waymo) and
1.79 m (nuScenes, Boston). KITTI's drives, all from one city and autumn, deviate by 0.022 (cars) and
0.026 (people); other cities and years by more."""

_GAUSSIAN = ("car", "person")  # classes whose types differ too little for components
_CORRELATION = 0.3  # between any two log sizes of the objects of one type


def in_region(model: CuboidSizes, region: Region) -> CuboidSizes:
    """The packaged `model`, which is for Europe, adapted to the road users of a region."""
    priors = dict(model.priors)
    for name, prior in model.priors.items():
        known = {one: _populated(name, prior, one) for one in _FRACTIONS}
        priors[name] = _mean(list(known.values())) if region == "unknown" else known[region]
    return CuboidSizes(priors, model.ground)


def _populated(name: str, prior: SizePrior, region: Region) -> SizePrior:
    """The prior of a class in a known region."""
    fractions = _FRACTIONS[region].get(name)
    drive_sigma = max(prior.drive_sigma, _DRIVE_SIGMA[region].get(name, 0.0))
    if fractions is None:
        wider = prior.covariance + (drive_sigma**2 - prior.drive_sigma**2)
        return _sized(prior, np.log(prior.hwl_m), wider, drive_sigma)
    types = [_TYPES[name][body] for body in fractions]
    weight = np.array(list(fractions.values()))
    mean, covariance = _moments(
        weight, np.log([one.hwl_m for one in types]), np.array([_within(one) for one in types])
    )
    if name in _GAUSSIAN:
        return _sized(prior, mean, covariance + drive_sigma**2, drive_sigma)
    bodies = [
        BodyType(
            name=body,
            share=fraction,
            hwl_m=one.hwl_m,
            log_sigma=one.log_sigma,
            correlation=(_CORRELATION,) * 3,
        )
        for (body, fraction), one in zip(fractions.items(), types, strict=True)
    ]
    return replace(_sized(prior, mean, covariance, drive_sigma), bodies=tuple(bodies))


def _mean(priors: Sequence[SizePrior]) -> SizePrior:
    """The prior of a class in any one of the regions, which are equally likely."""
    mean = np.log([prior.hwl_m for prior in priors])
    weight = np.full(len(priors), 1 / len(priors))
    total, covariance = _moments(weight, mean, np.array([prior.covariance for prior in priors]))
    drive_sigma = float(
        np.sqrt(np.mean([prior.drive_sigma**2 for prior in priors]) + mean[:, 0].var())
    )
    fractions: dict[str, float] = {}
    for prior in priors:
        for body in prior.bodies:
            fractions[body.name] = fractions.get(body.name, 0.0) + body.share / len(priors)
    # fitted sizes before tables
    kinds = {body.name: body for prior in reversed(priors) for body in prior.bodies}
    bodies = tuple(replace(kinds[name], share=fraction) for name, fraction in fractions.items())
    return replace(_sized(priors[0], total, covariance, drive_sigma), bodies=bodies)


def _sized(
    prior: SizePrior, mean: FloatArray, covariance: FloatArray, drive_sigma: float
) -> SizePrior:
    sigma = np.sqrt(np.diag(covariance))
    hw, hl, wl = (covariance / np.outer(sigma, sigma))[[0, 0, 1], [1, 2, 2]].tolist()
    height, width, length = np.exp(mean).tolist()
    of_height, of_width, of_length = sigma.tolist()
    return replace(
        prior,
        hwl_m=(height, width, length),
        log_sigma=(of_height, of_width, of_length),
        correlation=(hw, hl, wl),
        drive_sigma=drive_sigma,
    )


def _within(one: _Type) -> FloatArray:
    """(3, 3) covariance of the log sizes of one type."""
    correlation = np.full((3, 3), _CORRELATION) + (1 - _CORRELATION) * np.identity(3)
    return np.asarray(correlation * np.outer(one.log_sigma, one.log_sigma))


def _moments(
    weight: FloatArray, mean: FloatArray, covariance: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Mean (3,) and covariance (3, 3) of a mixture of Gaussians: (K,) weights, (K, 3) means, (K, 3,
    3) covariances.
    """
    total = weight @ mean
    shift = mean - total
    return total, np.einsum("k,kij->ij", weight, covariance) + (shift.T * weight) @ shift
