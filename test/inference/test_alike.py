"""Parts that are alike, in the fit beside which names are looked for: as in the estimator, by other rows."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from estimation.arms import Truth, efforts, motion, samples
from estimation.test_link_priors import HEAVIER, THIGHS, quadruped

from geomid_ros.inference.design import ChannelRows, Design
from geomid_ros.inference.fit import JointFit, fit
from geomid_ros.inference.prior import Prior
from geomid_ros.model.alike_parts import alike_parts
from geomid_ros.types import FloatArray

NOISE = 0.05


def design(links: FloatArray, legs: tuple[str, ...]) -> Design:
    """Of the efforts of some ``legs`` of a robot with these ``links (bodies, 10)``."""
    model, rng = quadruped(), np.random.default_rng(5)
    names = model.robot.joint_names
    moving = motion(rng, len(names), 8.0, rate=25.0)
    measured = efforts(model.robot, Truth(links, {}), moving) + NOISE * rng.normal(size=moving.position.shape)
    rows = model.rows(samples(moving, measured, rate=25.0))
    channels = []
    for channel, name in enumerate(names):
        own = np.column_stack([rows.coefficients[:, channel], rows.targets[:, channel]])
        own = own[: len(own) if name[:2] in legs else 0]
        channels.append(
            ChannelRows(own, np.zeros((len(own), 0)), np.zeros(0, dtype=np.intp), {}, np.arange(own.shape[1] - 1))
        )
    return Design.of(channels, rows.coefficients.shape[2])


def prior_of(alike: bool) -> Prior:
    """The URDF's."""
    model, none = quadruped(), np.zeros(0)
    parts = alike_parts(model.robot, model.identified) if alike else ()
    return Prior(
        inertias=model.nominal_inertias,
        prior_std=0.2,
        terms=(),
        values=none,
        prior_stds=none,
        certainty=20.0,
        alike=parts,
    )


@cache
def fitted(heavy: tuple[str, ...], legs: tuple[str, ...], alike: bool) -> tuple[JointFit, dict[str, float]]:
    """The fit, and masses over the URDF's."""
    model = quadruped()
    links = model.nominal_inertias.reshape(-1, 10).copy()
    links[[model.body_names.index(name) for name in heavy]] *= HEAVIER
    found = fit(design(links, legs), prior_of(alike), [])
    masses = found.inertias[:, 0] / model.nominal_inertias[::10]
    return found, dict(zip(model.body_names, masses.tolist(), strict=True))


def test_a_leg_that_was_repaired_is_let_go() -> None:
    """Its own spread grows, those of the others stay; what is written is what it is."""
    found, masses = fitted(THIGHS[1:2], ("FL", "FR", "RL", "RR"), True)
    names = [name for group in alike_parts(quadruped().robot, quadruped().identified) for name in group.names]
    spreads = dict(zip(names, found.separate_prior_stds.tolist(), strict=True))
    let_go = spreads.pop("FR_thigh")
    assert let_go > 1.5 * max(spreads.values())
    _, free = fitted(THIGHS[1:2], ("FL", "FR", "RL", "RR"), False)
    for name in THIGHS:
        assert masses[name] == pytest.approx(free[name], abs=0.05)


def test_own_spreads_are_those_of_the_best_score() -> None:
    """The fixed point is the minimum of the score that names are compared by."""
    legs = ("FL", "FR", "RL", "RR")
    found, _ = fitted(THIGHS[1:2], legs, True)
    links = quadruped().nominal_inertias.reshape(-1, 10).copy()
    links[quadruped().body_names.index(THIGHS[1])] *= HEAVIER
    for factor in (0.7, 1.4):
        other = replace(found, separate_prior_stds=factor * found.separate_prior_stds)
        assert fit(design(links, legs), prior_of(True), [], other, found.prior_stds).score > found.score + 1.0


@pytest.mark.parametrize("heavy", [THIGHS, THIGHS[1:2]])
def test_the_evidence_is_for_parts_that_are_alike(heavy: tuple[str, ...]) -> None:
    """And against them where one of them is another."""
    legs = ("FL", "FR", "RL", "RR")
    (alike, _), (apart, _) = (fitted(heavy, legs, alike) for alike in (True, False))
    (sound, _), (sound_apart, _) = (fitted((), legs, alike) for alike in (True, False))
    gain = (sound_apart.score - sound.score) - (apart.score - alike.score)
    assert (gain > 0.0) == (heavy == THIGHS[1:2])
