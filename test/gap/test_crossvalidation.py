"""What is there generalises to blocks of time that were left out; a coincidence of one block does not."""

from dataclasses import replace

from geomid_ros.gap import candidates as library
from geomid_ros.gap.candidates import Candidate
from geomid_ros.gap.evidence.noise import Autoregression
from geomid_ros.gap.evidence.record import Records
from geomid_ros.gap.fitting.fit import fit, unfitted
from geomid_ros.gap.fitting.linearised_problem import LinearisedProblem, total_model
from geomid_ros.gap.judgement.blocks import generalises
from geomid_ros.model.samples import Samples

from . import planted

MODEL = planted.model()
PRIOR = planted.prior()
VISCOUS = next(c for c in library.candidates(MODEL) if c.name == "viscous_friction" and c.joint == 1)


def survives(samples: Samples, candidate: Candidate) -> bool:
    problem = LinearisedProblem(MODEL, Records.make([samples], planted.CUTOFF), total_model(MODEL, unfitted(PRIOR)))
    noise = (Autoregression.white(),) * len(MODEL.channels)
    design = problem.design(problem.columns([candidate], ()), noise)
    return generalises(design, fit(design, PRIOR, [candidate]), candidate, PRIOR)


def test_friction_generalises() -> None:
    rigid = planted.rigid(planted.true_inertias(7, 0.2))
    assert survives(planted.recording(lambda q, v, a: rigid(q, v, a) + [0.0, 0.1, 0.0] * v, 7), VISCOUS)


def test_a_disturbance_of_a_moment_does_not() -> None:
    """Something pulled at the joint for two seconds, as friction would have."""
    exact = planted.recording(planted.rigid(planted.true_inertias(7, 0.2)), 7)
    effort = exact.effort.copy()
    moment = slice(8 * 64, 10 * 64)
    effort[moment, 1] += 1.0 * exact.velocity[moment, 1]
    assert not survives(replace(exact, effort=effort), VISCOUS)
