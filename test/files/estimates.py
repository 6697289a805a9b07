"""Estimates made by hand, for tests of what is written of them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from geomid_ros.estimation.estimate import EffectEstimate, Estimate, LinkEstimate, LinksInformation, Predictor
from geomid_ros.estimation.posterior import EffectCoordinate, Posterior
from geomid_ros.geometry import pseudo_inertia


def edited(*path: str | int, value: Any = None) -> Callable[[dict[str, Any]], None]:
    """A change of a document: another value at a path of keys, or none there."""

    def edit(content: Any) -> None:
        for key in path[:-1]:
            content = content[key]
        if value is None:
            del content[path[-1]]
        else:
            content[path[-1]] = value

    return edit


def link_estimate(name: str, merged: tuple[str, ...] = (), seed: int = 0) -> LinkEstimate:
    """A link with a body that can exist, made of random point masses."""
    random = np.random.default_rng(seed)
    masses, points = random.uniform(0.1, 1.0, 12), random.normal(scale=0.1, size=(12, 3))
    mass, com = masses.sum(), masses @ points / masses.sum()
    offsets = points - com
    inertia = np.einsum("n,n,ij->ij", masses, np.sum(offsets**2, axis=1), np.eye(3)) - np.einsum(
        "n,ni,nj->ij", masses, offsets, offsets
    )
    parameters = pseudo_inertia.assemble(np.array(mass), com, inertia)
    return LinkEstimate(
        name=name,
        merged=merged,
        parameters=parameters,
        std=np.array([0.01, *[0.002] * 3, *[1e-3] * 6]),
        distance_from_prior=0.3,
        from_data=0.5,
        min_eigenvalue_ratio=0.8,
        cannot_tell=("Ixx",),
        moments=("x", "y"),
        std_doubted=np.zeros(13),
        std_prior=np.full(13, np.inf),
        outlier=False,
    )


def estimate_of(*links: LinkEstimate, effects: tuple[EffectEstimate, ...] = ()) -> Estimate:
    """An estimate of two channels, the second of which was not measured."""
    parameters = np.concatenate([link.parameters for link in links] + [[e.value for e in effects]])
    of_channels = np.array([0.5, np.nan])
    covariance = np.random.default_rng(2).normal(scale=0.01, size=(len(parameters), len(parameters) + 1))
    information = np.triu(np.random.default_rng(1).normal(size=(10 * len(links), 10 * len(links))))
    return Estimate(
        converged=True,
        reason="gradient",
        seconds=0.25,
        steps=7,
        gamma=1e-3,
        rows_accepted=120,
        rows_set_aside=3,
        links=links,
        effects=effects,
        parameters=parameters,
        predictor=Predictor(parameters, np.ones(2)),
        channels=("joint1", "joint2"),
        sigmas=of_channels,
        prior_stds=np.full(len(links), 0.2),
        rms_nominal=2.0 * of_channels,
        rms=of_channels,
        information=LinksInformation(information, np.diag(information)),
        posterior=Posterior(
            links=tuple(link.name for link in links),
            merged=tuple(link.merged for link in links),
            effects=tuple(
                EffectCoordinate(name=e.name, place=e.joint, parameter=e.parameter, unit=e.unit, positive=e.value > 0.0)
                for e in effects
            ),
            parameters=parameters,
            covariance=covariance @ covariance.T,
            scales=np.full(sum(e.value <= 0.0 for e in effects), 2.0),
            prior=parameters,
            prior_stds=np.full(len(parameters), 0.2),
        ),
        rows=np.eye(len(parameters)),
        targets=parameters,
    )
