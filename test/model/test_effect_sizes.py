"""From coefficients to parameters: what they are, how sure they are, and which no robot has."""

import numpy as np
import pytest

from geomid_ros.model.effects import EFFECTS, Effect
from geomid_ros.model.effects.backlash import CROSSINGS, Backlash
from geomid_ros.model.effects.effort_gain import EffortGain
from geomid_ros.model.effects.joint_elasticity import JointElasticity
from geomid_ros.model.effects.load_friction import LoadFriction
from geomid_ros.model.effects.spring import Spring
from geomid_ros.model.effects.stribeck_friction import StribeckFriction

WITH_COEFFICIENTS = {name: cls() for name, cls in EFFECTS.items() if cls().parts}
DRAWS = 20_000


def coefficients_of(effect: Effect) -> np.ndarray:
    count = 6 if effect.place == "sensor" else sum(part.count for part in effect.parts)
    return np.array([0.5, 0.3, -0.2, 0.4, 0.6, -0.7])[:count]


@pytest.mark.parametrize("name", WITH_COEFFICIENTS)
def test_standard_deviations_are_those_of_parameters_of_random_coefficients(name: str) -> None:
    """Of coefficients whose errors belong together, as those of a spring and of its offset do."""
    effect = WITH_COEFFICIENTS[name]
    values = coefficients_of(effect)
    root = 1e-3 * np.random.default_rng(1).normal(size=(len(values), len(values)))
    draws = values + np.random.default_rng(2).standard_normal((DRAWS, len(values))) @ root.T
    parameters = np.array([list(effect.values(draw).values()) for draw in draws])
    found = list(effect.quantities(values, root @ root.T, usual_load=1.0).values())[: parameters.shape[1]]
    np.testing.assert_allclose([q.value for q in found], np.mean(parameters, axis=0), rtol=1e-3)
    np.testing.assert_allclose([q.std for q in found], np.std(parameters, axis=0), rtol=0.03)


def test_an_offset_that_is_unsure_makes_the_rest_of_a_spring_unsure() -> None:
    sharp, blurred = (Spring().quantities(np.array([2.0, -0.6]), np.diag([0.0, std**2])) for std in (0.0, 0.1))
    assert sharp["equilibrium"].value == blurred["equilibrium"].value == pytest.approx(0.3)
    assert (sharp["equilibrium"].std, blurred["equilibrium"].std) == (0.0, pytest.approx(0.05))


def test_the_scanned_constant_is_as_sure_as_its_logarithm() -> None:
    speed = StribeckFriction(0.2).quantities(np.array([1.0, 0.5]), np.zeros((2, 2)), unsure=0.1)["speed"]
    assert (speed.value, speed.std) == (0.2, pytest.approx(0.02))
    play = Backlash(3).quantities(np.array([0.01]), np.array([[1e-6]]), unsure=0.2, usual_load=5.0)["drag"]
    assert play.value == pytest.approx(5.0 * CROSSINGS[3] / 0.01)
    assert play.std / play.value == pytest.approx(np.hypot(0.2, 0.1))


@pytest.mark.parametrize(
    ("effect", "possible", "absurd"),
    [
        (JointElasticity(), [0.8], [1.2]),
        (JointElasticity(), [-0.8], [-1.2]),
        (Backlash(), [0.15], [0.25]),
        (LoadFriction(), [0.9], [1.1]),
        (EffortGain(), [0.45], [0.55]),
        (EffortGain(), [-0.45], [-0.55]),
        (StribeckFriction(), [1.0, 3.5], [1.0, 4.5]),
        (Spring(), [1.0, 12.0], [1.0, 13.2]),
        (Spring(), [1.0, -12.0], [1.0, -13.2]),
    ],
    ids=lambda value: value.name if isinstance(value, Effect) else str(value),
)
def test_sizes_that_no_robot_has_are_absurd(effect: Effect, possible: list[float], absurd: list[float]) -> None:
    """A gear that gives a radian per N m, play of 0.2 rad, friction that lets no effort through, half or twice the
    effort, an excess of four times the level, a spring that rests two turns away."""
    assert not effect.is_absurd(np.array(possible))
    assert effect.is_absurd(np.array(absurd))
