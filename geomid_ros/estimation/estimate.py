"""The result: what was found for each link and effect, how sure it is, and how it was found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from geomid_ros.model.effects import Quantity
from geomid_ros.types import FloatArray


@dataclass(frozen=True, eq=False)
class LinkEstimate:
    """A body under its moving link's name (``merged``: fixed links that are counted in).

    ``mass`` [kg], ``com (3,)`` [m] in the link's frame, ``inertia (3, 3)`` [kg m^2] about the centre of mass in the
    link's axes, each with its standard deviation; ``parameters (10,)`` the same about the link's origin.
    ``distance_from_prior``: geodesic. ``from_data``: share that came from the data rather than the prior, 0 to 1.
    ``min_eigenvalue_ratio``: smallest eigenvalue of ``P0^-1/2 P P0^-1/2``. ``cannot_tell``: quantities that the motion
    said little about.
    """

    name: str
    merged: tuple[str, ...]
    mass: float
    com: FloatArray
    inertia: FloatArray
    std_mass: float
    std_com: FloatArray
    std_inertia: FloatArray
    parameters: FloatArray
    distance_from_prior: float
    from_data: float
    min_eigenvalue_ratio: float
    cannot_tell: tuple[str, ...]


@dataclass(frozen=True)
class EffectEstimate:
    """An effect's coefficient at a joint, or at another place of that name.

    ``parameters``: the one that it is, which of an effect with several is named in ``parameter``, and the constants."""

    name: str
    joint: str
    value: float
    unit: str
    std: float
    from_data: float
    parameter: str
    parameters: Mapping[str, Quantity]


@dataclass(frozen=True)
class KnownEstimate:
    """A weighed mass [kg]: what ``name`` was said to weigh, and what it weighs by the estimate, each with its standard
    deviation."""

    name: str
    given: float
    given_std: float
    mass: float
    std: float


FINEST = 1e7
"""The inverse of the smallest relative error of an inertia that data are believed to tell."""


@dataclass(frozen=True, eq=False)
class LinksInformation:
    """What the data said of the inertias of all links together.

    ``|residuals + rows (x - parameters)|^2`` is minus twice the logarithm of the likelihood of link parameters x, up to
    a constant, with the effects that suit x best: ``residuals (10 links,)``, and ``rows (10 links, 10 links)``, upper
    triangular.
    """

    rows: FloatArray
    residuals: FloatArray


@dataclass(frozen=True, eq=False)
class Estimate:
    """All that a solve found.

    ``parameters (D,)`` of the measurement model; ``gamma`` the prior's share; ``sigmas`` and ``rms_*`` by channel in
    the channel's unit, NaN where nothing was measured. ``rows_set_aside``: of the compressed rows, those without a
    projection from the prior (only (19) sets rows aside).
    """

    converged: bool
    reason: str
    seconds: float
    steps: int
    gamma: float
    rows_accepted: int
    rows_set_aside: int
    links: tuple[LinkEstimate, ...]
    effects: tuple[EffectEstimate, ...]
    parameters: FloatArray
    channels: tuple[str, ...]
    sigmas: FloatArray
    rms_nominal: FloatArray
    rms: FloatArray
    information: LinksInformation
    known: tuple[KnownEstimate, ...] = ()
