"""The words that terminal and page share."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from files.gaps import gap_result

from geomid_ros.gap.result import LinkChange, Rival
from geomid_ros.model.effects import Quantity
from geomid_ros.report.gap_words import (
    interval,
    measured,
    next_recordings,
    ratio,
    summary,
    verdict_sentence,
)

JOINTS = ("hip", "knee", "ankle")


@pytest.mark.parametrize(
    ("quantity", "text", "range_"),
    [
        (Quantity(1.23456, 0.0123, "N m"), "1.235 ± 0.012 N m", "1.210 to 1.259"),
        (Quantity(-0.5, 0.2, "-"), "-0.50 ± 0.20", "-0.89 to -0.11"),
        (Quantity(1234.56, 98.7, "N m/rad"), "1235 ± 99 N m/rad", "1041 to 1428"),
        (Quantity(0.0123456, math.nan, "s"), "0.01235 s", "n/a"),
        (Quantity(-1.5902, 0.0047, "rad"), "-1.5902 ± 0.0047 rad", "-1.5994 to -1.5810"),
        (Quantity(2.0, 0.0, "kg"), "2 kg", "n/a"),
        (Quantity(0.0, math.nan, "kg"), "0 kg", "n/a"),
    ],
)
def test_values_are_as_exact_as_they_are_known(quantity: Quantity, text: str, range_: str) -> None:
    assert measured(quantity) == text
    assert interval(quantity, "offset", "effort_offset") == range_


def test_the_interval_holds_95_percent() -> None:
    """Of a normal distribution; that of what cannot be negative begins at zero."""
    assert interval(Quantity(0.0017, 0.003, "kg m^2"), "inertia", "rotor_inertia") == "0.0000 to 0.0076"
    low, high = map(float, interval(Quantity(0.0, 1.0, "m"), "offset", "effort_offset").split(" to "))
    draws = np.random.default_rng(0).normal(size=200_000)
    assert np.mean((draws > low) & (draws < high)) == pytest.approx(0.95, abs=0.005)


def test_of_many_findings_the_surest_are_named() -> None:
    result = gap_result("named", JOINTS)
    finding = result.findings[0]
    two = replace(result, findings=(finding, replace(finding, joint="hip")))
    assert verdict_sentence(two).startswith("Found: Coulomb friction at knee and at hip. With them, ")
    many = replace(result, findings=(finding, *(replace(finding, joint=f"toe{k}") for k in range(5))))
    first = "Coulomb friction at knee, Coulomb friction at toe0 and Coulomb friction at toe1"
    assert verdict_sentence(many).startswith(f"Found: 6 effects, most certainly {first}. With them, ")
    unsure = replace(many, findings=(replace(finding, joint="heel", probability=0.05), *many.findings))
    assert verdict_sentence(unsure).startswith(f"Found: 7 effects, most certainly {first}. With them, ")


def test_an_effect_with_likely_rivals_stands_with_them_not_with_its_size() -> None:
    result = gap_result("named", JOINTS)
    finding = result.findings[0]
    rival = Rival("effort_gain", "hip", -2.0)
    found = replace(result, findings=(finding, replace(finding, joint="hip", probability=0.3, rivals=(rival,))))
    sentences = summary(found)
    assert sentences[0].startswith("Sure: Coulomb friction at knee ")
    assert sentences[1] == "Ambiguous: Coulomb friction at hip or Effort gain at hip."


def test_links_that_changed_are_named() -> None:
    result = gap_result("named", JOINTS)
    change = LinkChange("thigh", "hip", Quantity(0.5, 0.01, "kg"), was=2.0, loss=1e6, probability=1.0)
    assert verdict_sentence(replace(result, findings=(), links=(change,))).startswith(
        "Found: a change of link 'thigh'. With it, "
    )
    both = replace(result, links=(change,))
    assert "knee and a change of link 'thigh'. With them, " in verdict_sentence(both)
    first, *_ = summary(both)
    assert first.startswith("Sure: mass of link 'thigh' is 0.5 ± 0.01 kg higher"), "its loss is the larger one"


def test_of_several_sizes_of_one_kind_the_one_that_is_told_is_said() -> None:
    result = gap_result("named", JOINTS)
    sizes = {"tilt_x": Quantity(-0.05, 0.04, "rad"), "tilt_y": Quantity(0.0339, 0.0011, "rad")}
    tilt = replace(result.findings[0], effect="gravity_tilt", joint="", link="", parameters=sizes)
    assert "tilt y 0.0339 ± 0.0011 rad" in summary(replace(result, findings=(tilt,)))[0]


@pytest.mark.parametrize(
    ("gains", "alike"),
    [((1.10, 1.11, 1.12), True), ((1.10, 1.11, 1.30), False), ((1.10, 1.11), False)],
    ids=["alike", "not alike", "not at all joints"],
)
def test_a_gain_of_all_joints_is_said_once(gains: tuple[float, ...], alike: bool) -> None:
    named = gap_result("named", JOINTS, wrench=True)
    (finding,) = named.findings
    found = [
        replace(finding, effect="effort_gain", joint=joint, parameters={"gain": Quantity(gain, 0.01, "-")})
        for joint, gain in zip(JOINTS, gains, strict=False)
    ]
    said = " ".join(summary(replace(named, findings=tuple(found))))
    assert ("Sure: efforts of all joints 1.1 to 1.12 times as large" in said) is alike
    assert ("Effort gain at hip" in said) is not alike


def test_the_verdict_says_what_was_found_and_what_it_was_judged_on() -> None:
    """A gap that a name does not touch, or that rest and reversals leave, is no number of its success."""
    result = gap_result("named", JOINTS)
    before, after = ratio(float(result.gap.before[1])), ratio(float(result.gap.after[1]))
    success = f"With it, the gap of knee falls from {before} to {after} times the noise floor."
    assert verdict_sentence(result) == f"Found: Coulomb friction at knee. {success}"
    high = np.array([40.0, 0.0, 0.0])  # of a channel that nothing reaches
    gap = replace(result.gap, before=result.gap.before + high, after=result.gap.after + high)
    assert "With it, the gap of knee falls" in verdict_sentence(replace(result, gap=gap))
    unsure = tuple(replace(finding, probability=0.7) for finding in result.findings)
    assert "With it" not in verdict_sentence(replace(result, findings=unsure))
    nothing = replace(gap_result("no gap", JOINTS), gap=replace(gap, before=gap.after))
    assert "within 1.02 times the noise floor while joints move (41.0 with rest" in verdict_sentence(nothing)
    known = replace(nothing, moving=np.array([6.0, 1.0, 1.0]))
    assert "up to 6.00 times the noise floor is left while joints move" in verdict_sentence(known)
    untested = replace(nothing, verdict="incomplete", unjudged=("hip", "knee"))
    assert verdict_sentence(untested).startswith("Found: no effect. Not tested: hip and knee; hold out more")
    closed = replace(result, verdict="no gap")
    assert "Corrected link inertias close the gap" in verdict_sentence(closed)
    joints = "friction, rotor inertias and offsets of joints"
    assert joints in verdict_sentence(replace(closed, ordinary=result.findings))


def test_what_is_left_is_part_of_the_verdict() -> None:
    incomplete, unexplained = (verdict_sentence(gap_result(case, JOINTS)) for case in ("incomplete", "unexplained"))
    assert "A residual remains at knee, which depends on its position" in incomplete
    assert "No known effect explains the residual at knee, which depends on the motion of hip" in unexplained
    assert "Found" not in unexplained


def test_what_to_record_next() -> None:
    assert next_recordings(gap_result("named", JOINTS)) == []
    assert next_recordings(gap_result("ambiguous", JOINTS)) == [
        "move knee at three constant speeds (for Coulomb friction at knee)"
    ]
    (slow,) = next_recordings(gap_result("incomplete", JOINTS))
    assert slow.startswith("a slow motion of the joint at one constant speed, ")
    assert slow.endswith("(for the residual at knee)")
    assert next_recordings(gap_result("unexplained", JOINTS)) == [
        "the joint alone, then hip alone, then both (for the residual at knee)"
    ]


def test_verdict_and_summary_repeat_nothing() -> None:
    """Neither each other nor the list of recordings below them."""
    case = replace(gap_result("unexplained", JOINTS), findings=gap_result("ambiguous", JOINTS).findings)
    said = " ".join([verdict_sentence(case), *summary(case)])
    assert said.count("Coulomb friction at knee") == 1
    assert next_recordings(case)
    assert not any(recording.partition(" (for")[0] in said for recording in next_recordings(case))


def test_what_to_record_next_of_several_places() -> None:
    """A motion of several joints is one of each; what is left on the base of legs is no joint's."""
    case, (finding,) = gap_result("unexplained", JOINTS), gap_result("ambiguous", JOINTS).findings
    places = [("base/fx", "load"), ("base/fz", "hip")]
    left = [replace(case.unexplained[0], joint=channel, depends_on=variable) for channel, variable in places]
    unsure = [replace(finding, joint=joint, settled_by="this joint at several speeds") for joint in JOINTS[:2]]
    of_joints, of_base = next_recordings(replace(case, findings=tuple(unsure), unexplained=tuple(left)))
    assert of_joints.startswith("each joint at several speeds (for ")
    assert of_base.startswith("the trunk swaying on all feet, then each leg in the air ")
    assert of_base.endswith("(for the residual at base/fx and the residual at base/fz)")
