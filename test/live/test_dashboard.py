"""What the dashboard makes of diagnostics, those of others and of liars among them."""

from __future__ import annotations

import json
import math
from types import SimpleNamespace
from typing import Any

import pytest

from geomid_ros.live.dashboard import state_of

LINK = {"mass": "2", "mass std": "0.1", "from data": "0.5", "merged": "tool", "not identifiable": "com x"}
STREAM = {
    "active": "True",
    "joint_states received": "12",
    "joint_states accepted": "9",
    "joint_states rejected: late: by 1 s": "2",
    "joint_states dropped: stopped": "1",
    "/ft received": "4",
    "/ft lost": "3",
    "rows rejected: standing still": "5",
    "joint1 sigma": "0.25",
    "joint1 rms": "0.5",
    "gap joint1": "4.5",
    "gap an arm's joint": "1.5",
}


def status(name: str, level: int, message: str, values: dict[str, str]) -> Any:
    """As much of a DiagnosticStatus as the page shows."""
    pairs = [SimpleNamespace(key=key, value=value) for key, value in values.items()]
    return SimpleNamespace(name=name, level=bytes([level]), message=message, values=pairs)


def diagnoses(**links: dict[str, str]) -> list[Any]:
    return [
        status("other: stream", 2, "of another node", {}),
        status("ns/geomid: stream", 1, "a gap", STREAM),
        status("ns/geomid: gap finding", 0, "looking", {"verdict": "named"}),
        *(status(f"ns/geomid: {name}", 0, "", values) for name, values in links.items()),
    ]


def test_nothing_is_known_of_a_node_that_says_nothing() -> None:
    assert state_of("geomid", diagnoses()) is None


def test_the_stream_is_sorted_by_what_it_is_about() -> None:
    state = state_of("ns/geomid", diagnoses())
    assert state is not None
    assert (state["node"], state["level"], state["message"]) == ("ns/geomid", "warning", "a gap")
    assert {channel.pop("name"): channel for channel in state["channels"]} == {
        "joint1": {"rms": 0.5, "sigma": 0.25, "gap": 4.5},
        "an arm's joint": {"gap": 1.5},
    }
    assert {topic.pop("name"): topic for topic in state["topics"]} == {
        "joint_states": {
            "received": "12",
            "accepted": "9",
            "rejected": [["late: by 1 s", "2"]],
            "dropped": [["stopped", "1"]],
        },
        "/ft": {"received": "4", "lost": "3"},
    }
    assert dict(state["numbers"]) == {"active": "True", "rows rejected: standing still": "5"}
    assert state["others"] == [
        {"name": "gap finding", "level": "ok", "message": "looking", "values": [("verdict", "named")]}
    ]


def test_a_mass_has_its_interval_along_the_geodesic() -> None:
    state = state_of("ns/geomid", diagnoses(link1=LINK))
    assert state is not None
    (link,) = state["links"]
    assert math.log(link["high"] / link["mass"]) == pytest.approx(1.96 * 0.1 / 2.0, rel=1e-3)
    assert link["low"] * link["high"] == pytest.approx(link["mass"] ** 2)
    assert (link["name"], link["std"], link["from_data"], link["merged"]) == ("link1", 0.1, 0.5, "tool")
    assert link["cannot_tell"] == "com x"


def test_whatever_is_said_it_is_json() -> None:
    """Of a mass, or of its standard deviation alone."""
    masses, deviations = ("nan", "-1", "0", "", "1e999", "heavy", "<b>"), ("nan", "inf", "-1", "wide")
    for mass, deviation in (*((bad, "0.1") for bad in masses), *(("2", bad) for bad in deviations)):
        state = state_of("ns/geomid", diagnoses(link1={"mass": mass, "mass std": deviation}))
        assert state is not None
        (link,) = json.loads(json.dumps(state, allow_nan=False))["links"]
        assert link["low"] is link["high"] is None, (mass, deviation)


def test_who_publishes_much_does_not_fill_the_page() -> None:
    """Of 500 statuses two are no links."""
    many = {f"link{number}": LINK | {f"key{other}": "1" for other in range(1000)} for number in range(1000)}
    state = state_of("ns/geomid", diagnoses(**many))
    assert state is not None
    assert len(state["links"]) == 498
    (state,) = [state_of("geomid", [status("geomid: stream", 0, "", {f"key{n}": "1" for n in range(1000)})])]
    assert state is not None
    assert len(state["numbers"]) == 500
