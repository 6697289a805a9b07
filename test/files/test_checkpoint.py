"""Checkpoints: what is read is what was written, to the last bit, or it is refused and kept."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import stat
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from model.robots import fixed_base, with_values

from geomid_ros.errors import GeomidError, InputError
from geomid_ros.estimation.estimator import WarmStart
from geomid_ros.files import checkpoints
from geomid_ros.files.archive import archived, decoded, encoded, pack, unpack
from geomid_ros.files.checkpoints import Checkpoint, CheckpointFolder
from geomid_ros.model.samples import Samples
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.session import Session
from geomid_ros.signals.gates import CLOCK_SET
from geomid_ros.signals.ledger import Account, driver_error, meaning_of

from .recordings import BAGS

GENERATIONS = ("checkpoint-a.safetensors", "checkpoint-b.safetensors")
INSTANTS = 400


def written(checkpoint: Checkpoint) -> bytes:
    return encoded(vars(checkpoint), checkpoint.accounts)


def session(robot: str = "arm3", **values: Any) -> Session:
    configuration = Configuration({"candidates": [], **values})
    return Session((BAGS / f"{robot}.urdf").read_text(encoding="utf-8"), configuration, robot)


def samples(of: Session, begin: int, end: int) -> Samples:
    """Instants of a motion of three tones, at 40 Hz, of an arm that is not quite the URDF's; at the end it stands."""
    rng = np.random.default_rng(0)
    joints = len(of.robot.joints)
    speeds, phases = rng.uniform(0.5, 5.0, (3, joints)), rng.uniform(0.0, 6.0, (3, joints))
    times = np.minimum(np.arange(begin, end), INSTANTS - 20)[:, None, None] / 40.0
    angles = speeds * times + phases
    moving = (np.arange(begin, end) < INSTANTS - 20)[:, None]
    motion = np.sin(angles).sum(1), moving * (speeds * np.cos(angles)).sum(1), -(speeds**2 * np.sin(angles)).sum(1)
    stamps = 10**18 + np.arange(begin, end) * 25_000_000
    unknown = fixed_base(stamps, *motion, np.zeros((end - begin, joints)))
    truth = np.append(1.1 * of.model.nominal_inertias, np.full(len(of.model.coefficients), 0.3))
    noise = 0.1 * np.random.default_rng(1).normal(size=(INSTANTS, joints))[begin:end]
    return with_values(unknown, effort=of.model.rows(unknown).coefficients @ truth + noise)


def learned(end: int = INSTANTS, **values: Any) -> Session:
    """A session that has seen so many instants, and messages of all fates."""
    result = session(**values)
    result.identifier.add(samples(result, 0, end))
    accounts = {"joint_states": Account(1234), "/wrench": Account(5, lost=6)}
    accounts["/wrench"].rejected["frame \N{SNOWMAN} is not 'tool'"] = 7
    accounts["joint_states"].dropped["queue full"] = 8
    accounts["joint_states"].noted["a joint too many"] = 9
    result.pipeline.ledger.restore(accounts)
    found = result.identifier.solve()
    result.warm_start = WarmStart(found.parameters, result.identifier.rows)
    return result


@cache
def checkpoint_of(end: int) -> Checkpoint:
    """What such a session has to keep."""
    return learned(end).checkpoint()


@cache
def small() -> tuple[Session, bytes]:
    """A session and the file of its checkpoint."""
    known = learned()
    return known, written(known.checkpoint())


def read(content: bytes) -> Checkpoint:
    """As a session like that of :func:`small` reads it."""
    checkpoint = decoded(Checkpoint, content, small()[0].meaning)
    session().restore(checkpoint)
    return checkpoint


class TestRoundTrip:
    """What was learned before the crash is known after it."""

    @pytest.mark.parametrize("forgetting_time", [0.0, 3.0])
    def test_it_goes_on_as_if_nothing_had_been(self, forgetting_time: float) -> None:
        """With the same rows to the last bit, and estimates that differ by nothing; also after more rows."""
        half = 170
        one, other = learned(half, forgetting_time=forgetting_time), session(forgetting_time=forgetting_time)
        checkpoint = decoded(Checkpoint, written(one.checkpoint()), other.meaning)
        other.restore(checkpoint)
        assert checkpoint.accounts == one.pipeline.ledger.topics
        assert other.identifier.rows == one.identifier.rows == 3 * half
        assert archived({"warm": other.warm_start}) == archived({"warm": one.warm_start})
        assert other.warm_start is not None
        for _ in range(2):
            rows = [archived(vars(identifier.memory())) for identifier in (one.identifier, other.identifier)]
            assert rows[0] == rows[1]
            found = [identifier.solve().parameters for identifier in (one.identifier, other.identifier)]
            np.testing.assert_allclose(found[0], found[1], rtol=1e-12, atol=0.0)
            for identifier in (one.identifier, other.identifier):
                identifier.add(samples(one, half, INSTANTS))
        rejected = one.identifier.counts.rejected
        assert rejected == other.identifier.counts.rejected
        assert rejected["standing still"] > 0

    def test_what_follows_from_reasons_is_kept(self) -> None:
        known, _ = small()
        account = Account(
            rejected=Counter({driver_error("no joint names"): 1, "late": 2}), noted=Counter({CLOCK_SET: 1})
        )
        found = read(written(replace(known.checkpoint(), accounts={"joint_states": account}))).accounts["joint_states"]
        assert {str(why): meaning_of(why) for why in found.rejected} == {
            "driver error: no joint names": "driver error",
            "late": "",
        }
        assert [meaning_of(why) for why in found.noted] == ["told"]

    def test_others_can_read_it(self) -> None:
        """The reference implementation of the format, if it is installed."""
        tensors = pytest.importorskip("safetensors.numpy").load(small()[1])
        _, vectors = unpack(small()[1])
        assert bytes(tensors.pop("sha256")) == small()[1][-32:]
        assert tensors.keys() == vectors.keys()
        for name, vector in vectors.items():
            np.testing.assert_array_equal(tensors[name], vector)


class TestDamage:
    """No damage goes unnoticed."""

    def test_truncated_or_with_a_flipped_bit(self) -> None:
        content, rng = small()[1], np.random.default_rng(0)
        for place in {*range(64), *range(-64, 0), *rng.integers(len(content), size=300).tolist()}:
            flipped = bytearray(content)
            flipped[place] ^= 1 << int(rng.integers(8))
            for damaged in (bytes(flipped), content[:place]):
                with pytest.raises(InputError, match="checksum"):
                    read(damaged)


def signed(body: bytes) -> bytes:
    return body + hashlib.sha256(body).digest()


def altered(change: Callable[[dict[str, Any], dict[str, Any]], Any]) -> bytes:
    """The small file with something else in it, and the checksum of that."""
    text, vectors = unpack(small()[1])
    document, changeable = json.loads(text), {name: vector.copy() for name, vector in vectors.items()}
    change(document, changeable)
    return pack(json.dumps(document), changeable)


def rows_of(document: dict[str, Any]) -> Any:
    return document["memory"]["summary"]


def first(document: dict[str, Any]) -> str:
    """The name of the first factor."""
    return str(rows_of(document)["factors"][0][0]["array"])


def pose(document: dict[str, Any]) -> str:
    return str(document["memory"]["last_pose"]["array"])


CRAFTED: dict[str, Callable[[dict[str, Any], dict[str, Any]], Any]] = {
    "has format 1": lambda d, _: d.update(format=1),
    r"factors\[0\]\[0\] is .*, expected an array": lambda d, v: v.update(x=v.pop(first(d))),
    "meanings.late is 'x', expected": lambda d, _: d["meanings"].update(late="x"),
    "does not say what": lambda d, _: d.update(meaning=None),
    "new is 1, here None": lambda d, _: d["meaning"].update(new=1),
    "rows have 15 folds": lambda d, _: rows_of(d)["factors"].pop(),
    "finite and not negative": lambda d, v: v[rows_of(d)["counts"]["array"]].__imul__(-1.0),
    "11 numbers are no triangle": lambda d, v: v.update({first(d): np.zeros(11)}),
    "numbers are no triangle": lambda d, _: rows_of(d)["factors"][0][0].update(shape=[2**31, 2**32]),
    "rows of channel 'joint1' have shape": lambda d, _: rows_of(d)["factors"][0].__setitem__(
        0, d["memory"]["last_pose"]
    ),
    "not enough values": lambda d, _: d["memory"]["last_pose"].update(triangle=True),
    "last pose has shape": lambda d, v: (v.update({pose(d): np.zeros(4)}), d["memory"]["last_pose"].update(shape=[4])),
    "an estimate of 3 parameters": lambda d, _: d["warm"].update(parameters=d["memory"]["last_pose"]),
}


class TestCrafted:
    """With the right checksum of something wrong."""

    @pytest.mark.parametrize("message", CRAFTED)
    def test_what_no_node_has_written_is_refused(self, message: str) -> None:
        with pytest.raises(InputError, match=message):
            read(altered(CRAFTED[message]))

    @pytest.mark.parametrize(
        "header",
        [
            b"",
            b"\xff\xfe",
            b"[" * 100_000,
            b'{"__metadata__": {"document": 1}}',
            b'{"__metadata__": {}, "x": []}',
            b'{"__metadata__": {}, "x": {"dtype": "F64", "shape": [1], "data_offsets": [0, 1e999]}}',
            b'{"__metadata__": {}, "x": {"dtype": "F64", "shape": [2], "data_offsets": [0, 8]}}',
            b'{"__metadata__": {}, "x": {"dtype": "F64", "shape": [0], "data_offsets": [0, 8]}}',
            b'{"__metadata__": {}, "x": {"dtype": "F64", "shape": [0], "data_offsets": [8, 0]}}',
            b'{"__metadata__": {"document": "' + b"[" * 100_000 + b'"}}',
        ],
        ids=range(10),
    )
    def test_headers(self, header: bytes) -> None:
        with pytest.raises(InputError):
            read(signed(len(header).to_bytes(8, "little") + header + bytes(8)))

    def test_other_vectors_than_are_said_and_infinity(self) -> None:
        body = pack("{}", {"x": np.zeros(2)})[:-32]
        for told in (b"[1]", b"[3]"):
            with pytest.raises(InputError, match="describes other vectors"):
                unpack(signed(body.replace(b"[2]", told)))
        text, vectors = unpack(small()[1])
        with pytest.raises(InputError, match="Infinity is not JSON"):
            read(pack(text.replace('"weight": ', '"weight": Infinity, "more": '), vectors))

    @settings(max_examples=100, deadline=None)
    @given(st.data())
    def test_nothing_but_our_own_errors(self, data: st.DataObject) -> None:
        """Bytes replaced in the header, or anything at all."""
        content = small()[1][:-32]
        place = data.draw(st.integers(0, 4000))
        piece = data.draw(st.binary(max_size=12) | st.sampled_from([b"null", b"-1", b"1e999", b"{}", b'"', b"9" * 30]))
        body = data.draw(st.sampled_from([content[:place] + piece + content[place + len(piece) :], piece]))
        with suppress(InputError):
            read(signed(body))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Two generations of a session, the newer with twice the rows."""
    path = tmp_path / "kept"
    with opened(path) as keeper:
        keeper.write(checkpoint_of(100))
        keeper.write(checkpoint_of(200))
    return path


@contextmanager
def opened(path: Path, of: Session | None = None) -> Iterator[CheckpointFolder]:
    of = of or session()
    with closing(CheckpointFolder(path, of.meaning, of.model.channels, of.configuration.buffer.folds)) as keeper:
        yield keeper


def restored(path: Path, of: Session | None = None) -> tuple[int, tuple[str, ...]]:
    """The rows with which a session goes on, and what is said."""
    of = of or session()
    with opened(path, of) as keeper:
        problems = keeper.restore(of.restore)[1]
    return of.identifier.rows, problems


def contents(path: Path) -> dict[str, bytes]:
    return {file.name: file.read_bytes() for file in path.iterdir() if file.name != ".lock"}


def newest(path: Path) -> Path:
    """The newer generation."""
    numbers = {name: json.loads(unpack((path / name).read_bytes())[0])["number"] for name in GENERATIONS}
    return path / max(numbers, key=lambda name: numbers[name])


def fail(*_: object) -> None:
    raise OSError(errno.ENOSPC, "No space left on device")


class TestFolder:
    """Two generations, and what could not be used is kept, unless there is much of it."""

    def test_the_newer_is_gone_on_from_and_the_older_replaced(self, folder: Path) -> None:
        """Nobody else may read them."""
        assert stat.S_IMODE(folder.stat().st_mode) == 0o700
        assert {stat.S_IMODE(file.stat().st_mode) for file in folder.iterdir()} == {0o600}
        for rows in (600, 900):
            assert restored(folder) == (rows, ())
            before = newest(folder)
            with opened(folder) as keeper:
                keeper.restore(session().restore)
                keeper.write(checkpoint_of(rows // 3 + 100))
            assert newest(folder) != before
            assert contents(folder).keys() == set(GENERATIONS)

    @pytest.mark.parametrize("damage", [lambda content: content[:-1], lambda _: b"", lambda content: content + b"\0"])
    def test_a_damaged_one_leaves_the_older(self, damage: Callable[[bytes], bytes], folder: Path) -> None:
        path = newest(folder)
        damaged = damage(path.read_bytes())
        path.write_bytes(damaged)
        rows, (problem,) = restored(folder)
        assert rows == 300
        assert str(path) in problem
        (aside,) = contents(folder).keys() - set(GENERATIONS)
        assert f"kept as {aside}" in problem
        assert contents(folder)[aside] == damaged
        assert restored(folder) == (300, ()), "it is said once"

    @pytest.mark.parametrize(
        ("other", "said"),
        [
            (lambda: session("arm7"), "of another robot"),
            (lambda: session(**{"filter.cutoff": 8.0}), "filter.cutoff is 5.0, here 8.0"),
            (lambda: session(effects=["viscous_friction"]), "; model.effects is [['coulomb_friction', 'joint1', "),
            (lambda: session(effort_gain=2.0), "effort_gain is 1.0, here 2.0"),
            (lambda: session(links=["link3"]), "links is"),
            (lambda: session(wrenches=["w"], **{"wrench.w.frame": "wrist_ft"}), "wrench.w.frame is None, here"),
        ],
    )
    def test_another_robot_s_is_refused_and_stays(self, other: Callable[[], Session], said: str, folder: Path) -> None:
        before = contents(folder)
        rows, problems = restored(folder, other())
        assert rows == 0
        assert len(problems) == 2
        for problem in problems:
            assert said in problem
        one = other()
        with opened(folder, one) as keeper:
            for _ in range(3):
                keeper.write(one.checkpoint())
        assert set(before.values()) < set(contents(folder).values())

    def test_of_what_was_set_aside_the_newest_are_kept(self, folder: Path) -> None:
        """And nothing is removed that is not ours."""
        foreign = folder / "unused-20000101T000000Z-notes.txt"
        foreign.write_text("of somebody else")
        (folder / f".{GENERATIONS[0]}.abcd").write_bytes(b"being written when the node was killed")
        for number in range(14):
            (folder / GENERATIONS[number % 2]).write_bytes(b"%d" % number)
            assert len(restored(folder)[1]) == 1
        kept = [path.read_bytes() for path in sorted(folder.glob("unused-*.safetensors"))]
        assert kept == [b"%d" % number for number in range(4, 14)]
        assert foreign.read_text() == "of somebody else"
        assert not [*folder.glob("*.abcd")]

    def test_what_does_not_change_rows_may_change(self, folder: Path) -> None:
        """What changes the estimate lets it be found anew, with another weight of the prior."""
        for value in ({"gamma": 0.1}, {"objective": "geodesic"}, {"known": ["total=9:0.1"]}, {"sigma.joint1": 1.0}):
            changed = session(**value)
            assert restored(folder, changed) == (600, ())
            assert changed.warm_start is None
        same = session(solve_period=2.0, still_speed=0.1)
        assert restored(folder, same) == (600, ())
        assert same.warm_start is not None

    def test_a_folder_of_others_is_refused(self, folder: Path, tmp_path: Path) -> None:
        (tmp_path / "open").mkdir(mode=0o755)
        (tmp_path / "file").write_text("")
        for path, said in (
            (tmp_path / "open", "mode 755"),
            (tmp_path / "file", "File exists"),
            (tmp_path / "file/below", "Not a directory"),
            (Path("/proc/geomid"), "no folder"),
        ):
            with pytest.raises(GeomidError, match=f"{path}: .*{said}"), opened(path):
                pass
        with opened(folder), pytest.raises(GeomidError, match="another node"), opened(folder):
            pass
        assert restored(folder) == (600, ())

    def test_what_is_no_file_is_refused(self, folder: Path, tmp_path: Path) -> None:
        """A pipe, which would never end; a link out of the folder; a file larger than memory."""
        (tmp_path / "elsewhere").write_bytes(newest(folder).read_bytes())
        for name in GENERATIONS:
            (folder / name).unlink()
        os.mkfifo(folder / GENERATIONS[0])
        (folder / GENERATIONS[1]).symlink_to(tmp_path / "elsewhere")
        rows, problems = restored(folder)
        assert (rows, len(problems)) == (0, 2)
        with (folder / GENERATIONS[0]).open("wb") as file:
            file.truncate(10**12)
        rows, (problem,) = restored(folder)
        assert rows == 0
        assert "larger than" in problem
        assert (tmp_path / "elsewhere").is_file()

    def test_a_disk_that_fails_leaves_both(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        before = contents(folder)
        with opened(folder) as keeper:
            keeper.restore(session().restore)
            with monkeypatch.context() as patch:
                patch.setattr(os, "fsync", fail)
                with pytest.raises(GeomidError, match=r"checkpoint-.*cannot be written \(No space left on device\)"):
                    keeper.write(checkpoint_of(300))
            assert contents(folder) == before
            keeper.write(checkpoint_of(300))
        assert restored(folder) == (900, ())

    def test_what_cannot_be_written_or_set_aside_is_an_error(
        self, folder: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """What is in the way is not replaced; a ledger may be too long."""
        before, other = contents(folder), session(effort_gain=2.0)
        accounts = {str(topic): Account() for topic in range(50_000)}
        with opened(folder) as keeper, pytest.raises(GeomidError, match="cannot be written"):
            keeper.write(replace(checkpoint_of(100), accounts=accounts))
        monkeypatch.setattr(checkpoints, "_renamed", fail)
        with opened(folder, other) as keeper:
            assert len(keeper.restore(other.restore)[1]) == 2
            with pytest.raises(GeomidError, match="cannot be set aside"):
                keeper.write(other.checkpoint())
        assert contents(folder) == before
