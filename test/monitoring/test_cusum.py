"""The parts of the change detector: what is normal, how sure it is, and how fast it is forgotten."""

from __future__ import annotations

import numpy as np
import pytest

from geomid_ros.model.measurement_model import Channel, Rows
from geomid_ros.monitoring.change_detection import _FEWEST, BLOCK, ChangeDetector, _Cusum

COLUMNS = 4
SECOND = 1_000_000_000  # [ns]
LEARNT = 2  # blocks of 40 rows for ten rows per parameter, here 40
NORMAL = _FEWEST  # blocks whose energies tell what is normal


def cusum(forgetting_time: float = np.inf) -> _Cusum:
    return _Cusum(Channel(name="joint", unit="N m", columns=np.arange(COLUMNS)), forgetting_time)


class Source:
    """Rows of one channel with white noise of standard deviation 1, of which a test took some blocks."""

    def __init__(self, seed: int = 0, blocks: int = 0) -> None:
        self.rng = np.random.default_rng(seed)
        self.parameters = self.rng.normal(size=COLUMNS)
        self.first, self.own = 0, cusum()
        for _ in range(blocks):
            self.block()

    def block(self, size: float = 1.0, measured: int = BLOCK) -> None:
        coefficients = self.rng.normal(size=(BLOCK, COLUMNS))
        targets = coefficients @ self.parameters + size * self.rng.normal(size=BLOCK)
        targets[measured:] = np.nan
        stamps = SECOND + 20_000_000 * np.arange(self.first, self.first + BLOCK)
        self.own.judge(self.first, stamps, coefficients, targets)
        self.first += BLOCK


def test_what_is_normal_is_known_after_enough_rows_and_blocks() -> None:
    source, ready = Source(), []
    for _ in range(20):
        source.block()
        ready.append(source.own.ready)
    assert ready.index(True) in (NORMAL, NORMAL + LEARNT - 1)
    assert all(ready[ready.index(True) :])


def test_the_normal_energy_is_the_variance_of_the_noise() -> None:
    """Of recursive residuals, however few rows there are; a change of their size is a gap of that size."""
    levels = []
    for seed in range(30):
        source = Source(seed)
        own = source.own
        for _ in range(40):
            source.block(0.5)
        levels.append(own._normal.level)
        assert own.gap.times_floor == pytest.approx(1.0, abs=0.4)
    assert np.mean(levels) == pytest.approx(0.25, rel=0.03)
    for _ in range(8):
        source.block(1.5)
    assert own.gap.times_floor == pytest.approx(3.0, rel=0.15)
    assert own.gap.since is not None


def test_a_suspicion_begins_with_its_first_block_and_ends_without_a_trace() -> None:
    source = Source(3, 40)
    own = source.own
    assert own.first_suspect is None
    first, energies = source.first, len(own._energies)
    source.block(3.0)
    assert own.first_suspect == first
    assert own.gap.since is None, "one block is none"
    assert len(own._energies) == energies
    for _ in range(6):
        source.block(0.9)
    assert own.first_suspect is None
    assert len(own._energies) > energies


def test_three_bad_blocks_are_a_gap_since_the_first() -> None:
    source = Source(4, 40)
    own = source.own
    first = source.first
    opened = []
    for _ in range(5):
        source.block(10.0)
        opened.append(own.gap.since is not None)
    assert opened == [False, False, True, True, True]
    assert own.gap.first_sample == first
    assert own.gap.since == SECOND + 20_000_000 * first
    closed = []
    for _ in range(6):
        source.block()
        closed.append(own.gap.since is None)
    assert not any(closed[:2]), "nor are two good blocks its end"
    assert closed[-1]


@pytest.mark.parametrize(("times", "opens"), [(1.3, False), (2.25, True)])
def test_a_gap_is_about_twice_the_floor(times: float, opens: bool) -> None:
    """Evidence grows where the mean square is more than twice what is usual."""
    for seed in range(5):
        source, opened = Source(seed, 40), False
        own = source.own
        for _ in range(40):
            source.block(times)
            opened = opened or own.gap.since is not None
        assert opened == opens


def test_what_was_learned_from_a_payload_is_unlearned() -> None:
    """It shows after some blocks; those before it came stay."""
    source = Source(1, 30)
    own = source.own
    factor, rows, came = own._factor, own._rows, source.first
    for _ in range(5):
        source.block(0.9)
    own.clear_suspicion(came)
    np.testing.assert_allclose(own._factor.T @ own._factor, factor.T @ factor)
    assert own._rows == rows


@pytest.mark.parametrize(("measured", "judged"), [(BLOCK // 2 - 1, False), (BLOCK // 2, True)])
def test_a_block_of_which_less_than_half_is_measured_says_nothing(measured: int, judged: bool) -> None:
    source = Source(5, 30)
    own = source.own
    rows, energies = own._rows, list(own._energies)
    source.block(measured=measured)
    assert own._rows == rows + judged * measured
    assert (list(own._energies) == energies) == (not judged)


@pytest.mark.parametrize(("forgetting", "step", "elapsed"), [(100.0, 20_000_000, 0.8), (50.0, 5 * SECOND, 40.0)])
def test_what_is_normal_is_forgotten_by_the_time_that_passes(forgetting: float, step: int, elapsed: float) -> None:
    """A pause counts as no more than a second; enough is kept to know what is normal."""
    own = cusum(forgetting)
    stamps = SECOND + step * np.arange(BLOCK)
    first = own._remaining(stamps)
    later = own._remaining(stamps + BLOCK * step)
    least = 1.0 - BLOCK / (2.0 * _FEWEST * COLUMNS)
    assert later == pytest.approx(max(np.exp(-elapsed / forgetting), least))
    assert first == pytest.approx(max(np.exp(-elapsed * (BLOCK - 1) / BLOCK / forgetting), least))
    assert least > 0.3


def test_rows_that_nobody_judges_do_not_fill_the_memory() -> None:
    """The last are kept: a hundred megabytes, or a block."""
    wide = ChangeDetector([Channel(name="joint", unit="N m", columns=np.arange(999))])
    count = 100_000_000 // (8 * 1000)
    rows = Rows(np.zeros((count + 70, 1, 1)), np.zeros((count + 70, 1)))
    wide.add(5, np.arange(count + 70), rows)
    assert len(wide._waiting) == count
    assert wide._waiting[0][0] == 75
    huge = ChangeDetector([Channel(name="joint", unit="N m", columns=np.array([10**9]))])
    huge.add(0, np.arange(100), Rows(np.zeros((100, 1, 1)), np.zeros((100, 1))))
    assert len(huge._waiting) == BLOCK
