"""The paper's own experiment (V-B) on measured rows: a person on a balance board, 16 bodies."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from geomid_ros.estimation.paper_estimator import RowsSolution, solve_rows
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.types import FloatArray

DATA = Path(__file__).parents[2].parent / "shared" / "data" / "human_lee_balanceboard" / "human_lee_balanceboard.npz"
pytestmark = pytest.mark.skipif(not DATA.is_file(), reason=f"measured data are kept outside the project: no {DATA}")

# From (m, h, Ixx, Iyy, Izz, Ixy, Iyz, Izx) to pinocchio's order.
ORDER = [0, 1, 2, 3, 4, 7, 5, 9, 8, 6]
PRIOR = (10.4, 14.1, 13.4)
# RMS of Mx, My [N m] and Fz [N] by gamma, as measured while planning.
REFERENCE = {1e-2: (4.8, 10.4, 16.4), 1e-3: (4.7, 8.7, 13.0)}
TOLERANCE = 0.06


class Human:
    """Rows, targets, standard deviations and prior of the recording."""

    def __init__(self) -> None:
        with np.load(DATA) as data:
            rows = data["A"].reshape(-1, 16, 10)
            self.rows = rows[:, :, ORDER].reshape(len(rows), 160)
            self.targets = data["b"].ravel()
            self.sigmas = np.tile(data["sigma"].ravel(), len(rows) // 3)
            self.prior = data["Phi_prior"].T[:, ORDER]

    def rms(self, parameters: FloatArray) -> FloatArray:
        """Of Mx, My, Fz."""
        errors = self.rows @ parameters.ravel() - self.targets
        return np.sqrt(np.mean(errors.reshape(-1, 3) ** 2, axis=0))

    def solve(self, gamma: float) -> RowsSolution:
        return solve_rows(self.rows, self.targets, self.sigmas, self.prior, gamma, exact=True)


@pytest.fixture(scope="module")
def human() -> Human:
    return Human()


def test_the_prior_predicts_as_in_the_papers_table(human: Human) -> None:
    np.testing.assert_allclose(human.rms(human.prior), PRIOR, atol=TOLERANCE)
    assert human.prior[:, 0].sum() == pytest.approx(64.0, abs=0.1)


@pytest.mark.parametrize("gamma", [1e-2, 1e-3, 1e-4, 1e-5])
def test_the_trust_region_converges_downhill_to_possible_links(human: Human, gamma: float) -> None:
    found = human.solve(gamma)
    values = np.array(found.solution.values)
    assert found.solution.converged
    assert np.all(np.diff(values) <= 1e-13 * values[:-1])
    assert np.all(np.linalg.eigvalsh(pseudo_inertia.from_parameters(found.parameters)) > 0.0)
    assert np.count_nonzero(found.set_aside) == 1
    assert found.parameters[:, 0].sum() == pytest.approx(63.5, abs=1.0)  # what the plate weighs
    if gamma in REFERENCE:
        np.testing.assert_allclose(human.rms(found.parameters), REFERENCE[gamma], atol=TOLERANCE)


def test_steps_are_few_where_the_alternation_needs_hundreds_of_cycles(human: Human) -> None:
    assert human.solve(1e-2).solution.steps <= 10
    alternation = solve_rows(human.rows, human.targets, human.sigmas, human.prior, 1e-2, "cyclic", 20, exact=True)
    assert not alternation.solution.converged
    assert alternation.solution.values[-1] > human.solve(1e-2).solution.values[-1]
