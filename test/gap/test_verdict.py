"""Findings, rivals, what is left without a name, and the words for it."""

from types import SimpleNamespace

import numpy as np
import pytest

from geomid_ros.gap import candidates as library
from geomid_ros.gap.judgement.held_out import located, share, strongest
from geomid_ros.gap.judgement.naming import sentence, settled_by
from geomid_ros.model.effects import EFFECTS, Quantity

from . import planted

MODEL = planted.model()
JOINTS = MODEL.robot.joint_names
CANDIDATES = library.candidates(MODEL)
PAYLOAD = next(c for c in CANDIDATES if c.payload == len(MODEL.identified) - 1)


class TestShare:
    """Of a mean square that a curve of one variable explains."""

    RNG = np.random.default_rng(3)
    VARIABLE = RNG.uniform(-1.0, 1.0, 4000)
    NOISE = RNG.standard_normal(4000)

    def test_a_smooth_curve_is_explained_and_noise_is_not(self) -> None:
        assert share(np.sin(2.0 * self.VARIABLE), self.VARIABLE) > 0.99
        assert share(self.NOISE, self.VARIABLE) < 0.01

    def test_a_sum_of_both_is_explained_in_part(self) -> None:
        both = 2.0 * self.VARIABLE + self.NOISE
        assert share(both, self.VARIABLE) == pytest.approx((4.0 / 3.0) / (4.0 / 3.0 + 1.0), abs=0.03)

    def test_what_curves_explain_of_noise_does_not_count(self) -> None:
        shares = [share(np.random.default_rng(k).standard_normal(60), self.VARIABLE[:60]) for k in range(200)]
        assert 0.0 <= min(shares) < 0.01
        assert np.mean(shares) < 0.1

    def test_nothing_is_said_of_too_few_or_of_one_place(self) -> None:
        assert share(np.arange(12.0), np.arange(12.0)) == 0.0
        assert share(np.arange(14.0), np.arange(14.0)) > 0.9
        assert share(self.VARIABLE, np.ones(4000)) == 0.0

    def test_what_is_not_measured_does_not_matter(self) -> None:
        values = np.sin(2.0 * self.VARIABLE) + self.NOISE
        holes = np.where(np.arange(4000) % 3 == 0, np.nan, values)
        kept = np.isfinite(holes)
        assert share(holes, self.VARIABLE) == share(values[kept], self.VARIABLE[kept])

    def test_a_wild_value_of_the_variable_does_not_spoil_its_curve(self) -> None:
        wild = self.VARIABLE.copy()
        wild[:10] *= 1e6
        assert share(np.sin(6.0 * self.VARIABLE), wild) > 0.9


def test_a_remainder_is_located_by_what_it_depends_on() -> None:
    """At three joints: on the second one's position, and on the direction of the third; the first shows its load."""
    rng = np.random.default_rng(8)
    position, velocity = rng.uniform(-1.0, 1.0, (2, 3000, 3))
    load = rng.uniform(0.0, 5.0, (3000, 3))
    samples = SimpleNamespace(seconds=np.arange(3000) * 0.01, position=position, velocity=velocity)
    residual = np.column_stack([(load[:, 0] - 2.5) ** 2 - 2.0, np.sin(3.0 * position[:, 1]), np.sign(velocity[:, 2])])
    found = located(MODEL, SimpleNamespace(samples=samples), residual, load)  # type: ignore[arg-type]
    assert [entry.channel for entry in found] == list(JOINTS)
    assert [strongest(entry) for entry in found] == ["load", "position", "reversals"]
    drifting = np.column_stack([np.linspace(-1.0, 1.0, 3000)] * 3)
    in_time = located(MODEL, SimpleNamespace(samples=samples), drifting, load)  # type: ignore[arg-type]
    assert [strongest(entry) for entry in in_time] == ["time"] * 3
    with_speed = located(MODEL, SimpleNamespace(samples=samples), velocity**3, load)  # type: ignore[arg-type]
    assert [strongest(entry) for entry in with_speed] == ["velocity"] * 3


def test_a_wrench_depends_on_load_and_time_alone() -> None:
    channels = (SimpleNamespace(name="wrench/fx", joint=None),)
    samples = SimpleNamespace(seconds=np.arange(500) * 0.01, position=np.zeros((500, 0)), velocity=np.zeros((500, 0)))
    load = np.random.default_rng(1).uniform(size=(500, 1))
    model, records = SimpleNamespace(channels=channels), SimpleNamespace(samples=samples)
    (found,) = located(model, records, load - 0.5, load)  # type: ignore[arg-type]
    assert (found.channel, strongest(found)) == ("wrench/fx", "load")
    assert (found.velocity, found.position, found.reversals) == (0.0, 0.0, 0.0)


FOUND = {"level": Quantity(0.5, 0.01, "N m"), "gain": Quantity(1.25, 0.1, "-")}


@pytest.mark.parametrize(
    ("joint", "link", "where"),
    [("elbow", "", " at 'elbow'"), ("elbow", "forearm", " at link 'forearm'"), ("", "", "")],
)
def test_a_sentence_says_what_where_and_how_much(joint: str, link: str, where: str) -> None:
    effect = EFFECTS["stribeck_friction"]()
    values = "level 0.5 ± 0.02 N m, gain 1.25 ± 0.2 (95 % interval)."
    assert sentence(effect, joint, link, FOUND, {}, "confident") == f"Stribeck friction{where}: {values}"
    assert sentence(effect, joint, link, FOUND, {}, "tentative") == f"Perhaps Stribeck friction{where}: {values}"


def test_a_sentence_begins_with_a_capital_and_says_the_first_parameters() -> None:
    found = {name: Quantity(1.0, 0.1, "m") for name in ("mass", "com_x", "com_y", "com_z", "ixx")}
    text = sentence(PAYLOAD.effect, "wrist", "hand", found, {}, "confident")
    assert text.startswith("A payload at link 'hand': mass 1 ± 0.2 m,")
    assert "com_z" in text
    assert "ixx" not in text


def test_what_settles_payloads_at_two_links_is_a_motion_that_turns_both() -> None:
    payload, spring = EFFECTS["payload"](), EFFECTS["spring"]()
    both = settled_by(payload, "wrist", [(payload, "elbow"), (spring, "base")])
    assert both == "a motion that turns 'wrist', 'elbow' through their ranges"
    assert settled_by(payload, "wrist", [(spring, "base")]) == payload.settled_by
    assert settled_by(spring, "wrist", [(spring, "elbow")]) == spring.settled_by
    assert settled_by(payload, "wrist", []) == payload.settled_by
