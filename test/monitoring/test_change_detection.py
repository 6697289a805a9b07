"""The change detector: silent while the robot stays what it is, whatever it does; not for long when it has changed."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from scipy.signal import firwin, lfilter

from geomid_ros.model.channels import Channel
from geomid_ros.model.measurement_model import Rows
from geomid_ros.monitoring.change_detection import _FEWEST, BLOCK, LATE, ChangeDetector, ChannelGap, _Cusum
from geomid_ros.types import FloatArray

COLUMNS = 12
BLOCKS = 80
HALF = BLOCK * BLOCKS // 2
PERIOD, SECOND = 20_000_000, 1_000_000_000  # [ns]
RISE = 3.0  # what the change adds, in standard deviations of the noise
DELAY, LONGER = 10, 20  # blocks
_LOW_PASS = firwin(33, 0.25)


def filtered(white: FloatArray) -> FloatArray:
    """As the pipeline's low-pass leaves it, with the standard deviation 1."""
    values: FloatArray = lfilter(_LOW_PASS, 1.0, white, axis=0)[len(_LOW_PASS) :]
    return values / np.linalg.norm(_LOW_PASS)


def noise(kind: str, rng: np.random.Generator, blocks: int) -> FloatArray:
    count = BLOCK * blocks
    white = rng.standard_normal(count + len(_LOW_PASS))
    if kind == "coloured":
        white = lfilter([1.0], [1.0, -0.9], white)
    values = filtered(white)
    values /= np.std(values)
    if kind == "uneven":  # rougher in one part of the motion than in the other
        values *= 1.0 + 0.6 * np.sin(2.0 * np.pi * np.arange(count) / 300.0)
    return values


class Robot:
    """One channel: ``targets = coefficients . parameters + noise``."""

    def __init__(self, seed: int, kind: str = "white", blocks: int = BLOCKS) -> None:
        rng = np.random.default_rng(seed)
        self.coefficients = filtered(rng.standard_normal((BLOCK * blocks + len(_LOW_PASS), COLUMNS)))
        self.targets = self.coefficients @ rng.normal(0.0, 10.0, COLUMNS) + noise(kind, rng, blocks)

    def change(self, begin: int = HALF, end: int | None = None) -> None:
        """From one row to another the first parameter is another."""
        self.targets[begin:end] += RISE * self.coefficients[begin:end, 0]

    def roughen(self, times: float, begin: int = HALF, end: int | None = None) -> None:
        """From one row to another what nothing explains is so many times the noise."""
        rough = self.targets[begin:end]
        rough += np.sqrt(times**2 - 1.0) * np.random.default_rng(0).standard_normal(len(rough))

    def judged(self, detector: ChangeDetector) -> Iterator[tuple[ChannelGap, ...]]:
        """The gaps after every block."""
        for begin in range(0, len(self.targets), BLOCK):
            rows = slice(begin, begin + BLOCK)
            stamps = PERIOD * np.arange(begin + 1, begin + BLOCK + 1)
            targets = self.targets[rows].reshape(BLOCK, -1)
            coefficients = np.repeat(self.coefficients[rows, None], targets.shape[1], axis=1)
            detector.add(begin, stamps, Rows(coefficients, targets))
            assert detector.test()
            assert not detector.test()
            yield detector.gaps


def new_detector(forgetting_time: float = np.inf) -> ChangeDetector:
    return ChangeDetector([Channel(name="joint", unit="N m", columns=np.arange(COLUMNS))], forgetting_time)


def open_blocks(robot: Robot, forgetting_time: float = np.inf) -> list[int]:
    """After which blocks there is a gap."""
    judged = robot.judged(new_detector(forgetting_time))
    return [block for block, gaps in enumerate(judged) if any(gap.since is not None for gap in gaps)]


@pytest.mark.parametrize("kind", ["coloured", "uneven"])
def test_no_false_alarm(kind: str) -> None:
    """In 3200 blocks, 48 minutes of motion: 1e-7 of them may."""
    watched = 0
    for seed in range(16):
        for gaps in Robot(seed, kind, 200).judged(new_detector()):
            watched += len(gaps)
            assert all(gap.since is None for gap in gaps), seed
    assert watched > 0.8 * 16 * 200


@pytest.mark.parametrize("kind", ["coloured", "uneven"])
def test_a_change_opens_a_gap(kind: str) -> None:
    """And it stays open; noise that differs from one part of the motion to the other costs time."""
    delays = []
    for seed in range(8):
        robot = Robot(seed, kind)
        robot.change()
        opened = open_blocks(robot)
        assert opened == list(range(opened[0], BLOCKS))
        delays.append(opened[0] - BLOCKS // 2)
    assert min(delays) >= 0
    assert np.median(delays) < (LONGER if kind == "uneven" else DELAY)


def test_the_gap_says_how_wide_it_is_and_since_when() -> None:
    """In units of the noise floor, which is the variance of the noise, however few rows there are."""
    widths, begins, variances = [], [], []
    for seed in range(8):
        robot, detector = Robot(seed), new_detector()
        robot.change()
        *_, (gap,) = robot.judged(detector)
        assert gap.since is not None
        assert detector.changes == [(gap.since, gap.first_sample)]
        begins.append(gap.since / PERIOD)
        widths.append(gap.times_floor)
        variances.append(detector._channels[0].noise.variance)
    assert abs(np.median(begins) - HALF) <= BLOCK
    assert np.median(widths) == pytest.approx(np.hypot(1.0, RISE), rel=0.1)
    assert np.mean(variances) == pytest.approx(1.0, rel=0.05)


@pytest.mark.parametrize(("times", "opens"), [(1.3, False), (2.25, True)])
def test_a_gap_is_about_twice_the_floor(times: float, opens: bool) -> None:
    """Evidence grows where the mean square is more than twice what is usual."""
    for seed in range(5):
        robot = Robot(seed)
        robot.roughen(times)
        assert bool(open_blocks(robot)) == opens


def test_three_bad_blocks_are_a_gap_since_the_first() -> None:
    """And two good ones are not its end."""
    robot, detector, end = Robot(4), new_detector(), HALF + 5 * BLOCK
    robot.roughen(10.0, HALF, end)
    since = {block: gap.since for block, gaps in enumerate(robot.judged(detector)) for gap in gaps}
    opened = [block for block, stamp in since.items() if stamp is not None]
    assert {since[block] for block in opened} == {PERIOD * (HALF + 1)}
    assert opened == list(range(BLOCKS // 2 + 2, opened[-1] + 1))
    assert end // BLOCK + 2 <= opened[-1] + 1 < end // BLOCK + DELAY


@pytest.mark.parametrize(("measured", "judged"), [(BLOCK // 2 - 1, False), (BLOCK // 2, True)])
def test_a_block_of_which_less_than_half_is_measured_says_nothing(measured: int, judged: bool) -> None:
    robot = Robot(5)
    robot.roughen(10.0)
    robot.targets[HALF:].reshape(-1, BLOCK)[:, measured:] = np.nan
    assert bool(open_blocks(robot)) == judged


def test_a_motion_that_shows_new_parameters_opens_none() -> None:
    """However wrong they were taken to be: here they are ten times the noise, each."""
    for seed in range(5):
        rng = np.random.default_rng(seed)
        robot = Robot(seed)
        robot.coefficients[:HALF, COLUMNS // 2 :] *= 1e-4  # hardly excited at first
        robot.targets = robot.coefficients @ rng.normal(0.0, 10.0, COLUMNS) + noise("white", rng, BLOCKS)
        assert open_blocks(robot) == []


def test_nothing_is_said_before_it_is_known_what_is_normal() -> None:
    """A change in the first seconds is not seen, rather than guessed at."""
    robot = Robot(0)
    robot.change(BLOCK)
    judged = list(robot.judged(new_detector()))
    assert judged[:12] == 12 * [()]
    assert all(judged[14:])
    assert all(gap.since is None for gaps in judged for gap in gaps)


def test_what_was_undone_closes_the_gap() -> None:
    robot = Robot(1)
    end = HALF + 15 * BLOCK
    robot.change(HALF, end)
    opened = open_blocks(robot)
    assert opened == list(range(opened[0], opened[-1] + 1))
    assert end // BLOCK <= opened[-1] < end // BLOCK + 2 * DELAY


def test_a_bump_is_no_gap() -> None:
    """It is suspect from its first row on, and forgotten soon."""
    for seed in range(5):
        robot, detector, behind = Robot(seed), new_detector(), []
        robot.targets[HALF : HALF + BLOCK] += 1e3 * np.sin(np.arange(BLOCK))
        for gaps in robot.judged(detector):
            assert all(gap.since is None for gap in gaps)
            behind.append(detector.searched_until - detector.unchanged_before([0]))
        bump = BLOCKS // 2
        assert behind[bump] == LATE + BLOCK
        assert behind[bump + 10] == LATE


def test_who_forgets_gets_used_to_it() -> None:
    """The estimate follows what has changed, and so does what is normal."""
    robot = Robot(2, blocks=200)
    robot.change()
    opened = open_blocks(robot, 10.0)
    assert BLOCKS // 2 <= opened[0] < BLOCKS // 2 + DELAY
    assert opened[-1] < 150
    assert open_blocks(robot)[-1] == 199, "who does not forget, does not"


def test_rounding_is_no_gap() -> None:
    """A simulation that the model explains to the last digit."""
    robot = Robot(4)
    robot.targets = robot.coefficients @ np.arange(COLUMNS)
    robot.targets[HALF:] *= 1.0 + 1e-7
    assert open_blocks(robot) == []


def test_channels_are_judged_by_themselves() -> None:
    """What one does not measure, or measures as zero, costs the other nothing."""
    robot = Robot(5)
    robot.change()
    channels = [Channel(name=name, unit="N m", columns=np.arange(COLUMNS)) for name in ("silent", "zero", "joint")]
    count = len(robot.targets)
    robot.targets = np.column_stack([np.full(count, np.nan), np.zeros(count), robot.targets])
    *_, last = robot.judged(ChangeDetector(channels))
    gaps = {gap.channel: gap for gap in last}
    assert gaps.keys() == {"zero", "joint"}
    assert gaps["zero"].since is None
    assert gaps["joint"].since is not None


LONGEST = 21  # blocks: a suspicion, and the one before it


class TestNormal:
    """What is kept for good."""

    @staticmethod
    def followed(robot: Robot) -> Iterator[tuple[int, int, ChannelGap | None]]:
        """After every block how many instants were judged, how many are normal, and the gap if it is open."""
        detector = new_detector()
        for gaps in robot.judged(detector):
            opened = [gap for gap in gaps if gap.since is not None]
            yield detector.searched_until, detector.unchanged_before([0]), opened[0] if opened else None

    @pytest.mark.parametrize("kind", ["coloured", "uneven"])
    def test_nothing_of_a_gap_is_kept_before_it_opens(self, kind: str) -> None:
        """Nor of the block before it; unless it has been suspect for longer than a suspicion lasts."""
        for seed in range(8):
            robot = Robot(seed, kind)
            robot.change(HALF - 10)  # in the last rows of a block
            kept = 0
            for judged, normal, gap in self.followed(robot):
                if gap is not None:
                    assert kept <= max(gap.first_sample - LATE, judged - LONGEST * BLOCK)
                    break
                kept = normal
            else:
                pytest.fail("no gap")
            if kind != "uneven":  # where the first of what is bad may be taken for rough
                assert kept <= gap.first_sample - LATE <= HALF - 10, seed

    def test_what_is_as_it_was_is_kept_soon(self) -> None:
        """All but one or two blocks, mostly."""
        behind = [judged - normal for judged, normal, _ in self.followed(Robot(0, "coloured", 300))]
        assert np.median(behind) == LATE
        assert np.mean(np.array(behind) <= LATE + BLOCK) > 0.8

    def test_a_gap_that_stays_open_does_not_hold_up_everything(self) -> None:
        robot = Robot(1)
        robot.change()
        *_, (judged, normal, gap) = self.followed(robot)
        assert gap is not None
        assert judged - normal == (LONGEST - 1) * BLOCK

    def test_of_no_channel_all_but_the_last_block_is_kept(self) -> None:
        robot, detector = Robot(2), new_detector()
        robot.change()
        for _ in robot.judged(detector):
            assert detector.unchanged_before([]) == detector.searched_until - LATE


class Imperfect(Robot):
    """A robot with more effects than its model has, in a motion that repeats itself and then another one, in turns."""

    def __init__(self, seed: int, turns: int = 1) -> None:
        super().__init__(seed, blocks=4 * BLOCKS)
        count, rng = len(self.targets), np.random.default_rng(seed)
        phases = 2.0 * np.pi * np.outer(np.arange(count), rng.uniform(0.005, 0.01, 1) * np.array([1.0, 2.0, 3.0]))
        other = filtered(rng.standard_normal((count + len(_LOW_PASS), 3)))
        first = (np.arange(count) * 2 * turns // count % 2 == 0)[:, None]
        motion = np.where(first, np.sin(phases + rng.uniform(0.0, 6.0, 3)), other)
        turned = np.column_stack([motion @ rng.normal(0.0, 1.0, 3) for _ in range(COLUMNS)])
        self.coefficients = np.column_stack([np.sin(turned[:, : COLUMNS // 2]), np.cos(turned[:, COLUMNS // 2 :])])
        lacking = 3.0 * np.tanh(turned[:, 1] * turned[:, 2]) + 3.0 * np.sign(turned[:, 3])
        self.targets = self.coefficients @ rng.normal(0.0, 10.0, COLUMNS) + lacking + noise("white", rng, 4 * BLOCKS)


def test_another_motion_is_no_gap_where_the_model_lacks_something() -> None:
    """What it lacks was fitted away along the first motion, and is not along the other."""
    assert not open_blocks(Imperfect(1))


def test_what_was_normal_in_a_motion_is_so_when_it_returns() -> None:
    """It leaves more than the other one, which has lasted for so long that nothing else is recent."""
    assert not open_blocks(Imperfect(1, turns=2))


@pytest.mark.parametrize("begin", [BLOCKS, 3 * BLOCKS + BLOCKS // 2])
def test_a_change_shows_in_either_motion(begin: int) -> None:
    """Once it is known what is normal in it."""
    delays = []
    for seed in range(5):
        robot = Imperfect(seed)
        robot.targets[begin * BLOCK :] += 25.0 * robot.coefficients[begin * BLOCK :, 0]
        delays.append(open_blocks(robot)[0] - begin)
    assert min(delays) >= 0
    assert np.median(delays) < DELAY


def test_what_was_normal_in_another_kind_of_motion_is_forgotten() -> None:
    """A rough motion, then a quiet one that shows other parameters: a change in it is not lost in the roughness."""
    found = []
    for seed in range(5):
        rng = np.random.default_rng(seed)
        robot = Robot(seed, blocks=2 * BLOCKS)
        robot.coefficients[:HALF, COLUMNS // 2 :] *= 1e-2
        rough = np.where(np.arange(len(robot.targets)) < HALF, 8.0, 1.0)
        robot.targets = robot.coefficients @ rng.normal(0.0, 10.0, COLUMNS) + rough * noise("white", rng, 2 * BLOCKS)
        robot.change(2 * HALF)
        opened = open_blocks(robot)
        assert all(block >= BLOCKS for block in opened)
        found.append(bool(opened) and opened[0] < BLOCKS + DELAY)
    assert np.mean(found) >= 0.7


def test_what_was_learned_from_a_payload_is_unlearned() -> None:
    """It shows after some blocks; those before it came stay."""
    detector = new_detector()
    judged, (own,) = Robot(1).judged(detector), detector._channels
    for _ in range(30):
        next(judged)
    factor, rows, came = own._factor, own._rows, detector.searched_until
    for _ in range(5):
        next(judged)
    assert own._rows > rows
    own.clear_suspicion(came)
    np.testing.assert_allclose(own._factor.T @ own._factor, factor.T @ factor, atol=1e-6)
    assert own._rows == rows


@pytest.mark.parametrize(
    ("forgetting", "step", "elapsed"), [(100.0, 20_000_000, 0.8), (50.0, 5 * SECOND, 40.0), (1.0, SECOND, np.inf)]
)
def test_what_is_normal_is_forgotten_by_the_time_that_passes(forgetting: float, step: int, elapsed: float) -> None:
    """A pause counts as no more than a second; enough is kept to know what is normal."""
    own = _Cusum(Channel(name="joint", unit="N m", columns=np.arange(COLUMNS)), forgetting)
    stamps = SECOND + step * np.arange(BLOCK)
    least = 1.0 - BLOCK / (2.0 * _FEWEST * COLUMNS)
    assert own._remaining(stamps) == pytest.approx(max(np.exp(-elapsed * (BLOCK - 1) / BLOCK / forgetting), least))
    assert own._remaining(stamps + BLOCK * step) == pytest.approx(max(np.exp(-elapsed / forgetting), least))


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
