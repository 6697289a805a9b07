"""Verification of a model on disk against a recording and against requirements of the user.

A requirement is ``[PLACE.]QUANTITY COMPARISON BOUND`` (``rms<2*floor``, ``joint2.rms<1.5``, ``total.mass<24``).
Without a place it applies to every place but ``total`` where quantity and reference are measured and known. Quantities:

- ``rms``, of a channel: RMS of the residual of the model on the recording [N m, N];
- ``mass``, of a link, or of the whole robot with its fixed links, ``total``: [kg];
- ``from_data``, of a link: fraction of the prior variance that the data removed, 0 to 1.

A comparison is ``<``, ``<=``, ``>`` or ``>=``. A bound is a number, ``floor``, ``urdf``, or a number times one of them:
``2*floor``. The floor of an rms is the noise floor of the data that the model was fitted to. ``urdf`` is the same
quantity of the URDF, with the sensor corrections of the model.
"""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from geomid_ros.api.robot import (
    bag_paths,
    check_command_efforts,
    configuration,
    description,
    identified_urdf_path,
    topics,
)
from geomid_ros.checks.verdict import recording_verdict
from geomid_ros.errors import InputError, check_name, unknown_name
from geomid_ros.files.models.estimate_file import EstimateFile
from geomid_ros.model.effects import DEFAULT_EFFECTS
from geomid_ros.model.samples import Samples
from geomid_ros.model.weighed_masses import TOTAL
from geomid_ros.options import takes
from geomid_ros.session.gap import rms_of_model
from geomid_ros.session.options import PathLike, Paths, RobotOptions, VerifyOptions, texts
from geomid_ros.session.recordings import Bags, read_fitted
from geomid_ros.session.session import Session, predicting_session


@dataclass(frozen=True, kw_only=True, eq=False)
class Verification:
    """Result of checking a model against a recording.

    Attributes:
        session: the robot and its model.
        rms: by channel, residual RMS of the model (``value``), RMS of the noise (``floor``; if the file has none, the
            model's on its fitted data), and residual RMS of the URDF (``urdf``); NaN if not measured or not known.
        doubts: reasons to doubt the model or the recording.
        outcomes: result of each requirement.
    """

    session: Session
    rms: Values
    doubts: Sequence[str]
    outcomes: Sequence[Outcome]

    @property
    def passed(self) -> bool:
        """True if all requirements hold and nothing is doubtful."""
        return not self.doubts and all(outcome.passed is not False for outcome in self.outcomes)

    def __repr__(self) -> str:
        """Reasons for doubt, whether it passed, and a line for each channel and requirement."""
        channels = (
            f"  {name}: {', '.join(f'{of} {number:.3g}' for of, number in numbers.items())}"
            for name, numbers in self.rms.items()
        )
        heading = f"Verification of {self.session.robot.name}: {'passed' if self.passed else 'FAILED'}; RMS residual"
        return "\n".join([*self.doubts, heading, *channels, *(f"  {outcome.sentence}" for outcome in self.outcomes)])


@takes(VerifyOptions)
def verify(options: VerifyOptions) -> Verification:
    """Predict recordings with an existing model, and check requirements.

    ``geomid verify`` calls this; its options have the same names. Requirements are explained in
    :mod:`~geomid_ros.api.verify`.

    Raises:
        InputError: a file, an argument, a requirement or the data cannot be used.
    """
    required = [Requirement.parse(text) for text in texts(options.require)]
    file = EstimateFile.read(Path(options.model))
    relative = next((each for each in required if each.reference == "urdf"), None)
    if relative and options.urdf is None and (path := identified_urdf_path(options.model)).is_file():
        raise InputError(
            f"requirement '{relative.text}' compares with the URDF before, and {path} is the identified one; name the "
            "former with --urdf"
        )
    # The description may have friction of kinds that the model has not.
    session, samples = read_test_samples(
        options, options.validate, model=options.model, effects=DEFAULT_EFFECTS, cutoff=file.cutoff
    )
    values = _values(session, samples, file)
    return Verification(
        session=session,
        rms=values["rms"],
        doubts=[*file.doubts, *recording_verdict(session.review.findings).reasons],
        outcomes=[outcome for requirement in required for outcome in requirement.checked(values)],
    )


def read_test_samples(
    options: RobotOptions,
    bags: Paths,
    *,
    model: PathLike | None = None,
    effects: Sequence[str] = (),
    cutoff: float | None = None,
) -> tuple[Session, Sequence[Samples]]:
    """Return a session of the robot, and all samples of the recordings to test a model on.

    Args:
        options: which robot it is, and how the recordings are read.
        bags: the recordings.
        model: an estimate.json; None for the URDF alone.
        effects: names of effects that the model has at every joint in addition to those of the estimate.
        cutoff: low-pass cutoff [Hz] that the floor of the model refers to, unless the options set another.
    """
    recorded = Bags(fitted=bag_paths(bags), hold_out=0.0, topics=topics(options))
    robot = description(options, recorded.fitted, model)
    parameters = configuration(options, model, effects=[*effects], candidates=[])
    if cutoff is not None and "filter.cutoff" not in parameters.given_values:
        parameters = parameters.with_values({"filter.cutoff": float(cutoff)})
    checked = check_command_efforts(options, parameters)
    return robot.read(predicting_session, checked, lambda session: read_fitted(session, recorded, options.progress))


def _values(session: Session, samples: Sequence[Samples], file: EstimateFile) -> dict[str, Values]:
    """Return the values of every quantity that a requirement can name."""
    nominal, parameters = session.model.described_parameters, session.known_parameters
    channels = [channel.name for channel in session.model.channels]
    floors = file.floor or file.rms.train
    without_gains = 1.0 / session.model.drive_gains
    residual_rms = rms_of_model(session, samples), session.rms(samples, nominal, without_gains)
    errors = zip(channels, *(each.tolist() for each in residual_rms), strict=True)
    bodies = session.model.body_names
    masses = [each[: 10 * len(bodies) : 10].tolist() for each in (parameters, nominal)]
    fixed = session.model.unidentified_mass
    with_total = zip([*bodies, TOTAL], *([*each, sum(each) + fixed] for each in masses), strict=True)
    return {
        "rms": {name: {"value": fit, "floor": floors.get(name, math.nan), "urdf": urdf} for name, fit, urdf in errors},
        "mass": {name: {"value": fit, "urdf": urdf} for name, fit, urdf in with_total},
        "from_data": {link.name: {"value": link.from_data} for link in file.links},
    }


QUANTITIES = {"rms": ("floor", "urdf"), "mass": ("urdf",), "from_data": ()}
"""References that the bound of a quantity may be a multiple of, by quantity."""

_COMPARISONS: dict[str, Callable[[float, float], bool]] = {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
}
_NUMBER = r"\d+\.?\d*(?:[eE][-+]?\d+)?|\.\d+(?:[eE][-+]?\d+)?"
_FORM = re.compile(
    rf"\s*(?:(?P<place>.+)\.)?(?P<quantity>[a-z_]+)\s*(?P<comparison><=|>=|<|>)\s*"
    rf"(?:(?P<number>{_NUMBER})(?:\s*\*\s*(?P<times>[a-z]+))?|(?P<reference>[a-z]+))\s*"
)
_LONGEST = 500  # characters
_HOW = "expected [PLACE.]QUANTITY<BOUND, e.g. 'rms<2*floor', 'joint2.rms<1.5', 'total.mass<1.1*urdf', 'from_data>=0.1'"

Values = Mapping[str, Mapping[str, float]]
"""Numbers by place; within a place, by ``value`` and the names of the references."""


@dataclass(frozen=True)
class Requirement:
    """Requirement that a ``quantity`` at a ``place`` (empty: all) satisfies ``comparison`` with ``factor`` times the
    ``reference``, which is empty for a plain number. ``text`` is what the user wrote."""

    text: str
    place: str
    quantity: str
    comparison: str
    factor: float
    reference: str

    @staticmethod
    def parse(text: str) -> Requirement:
        """Parse a requirement.

        Raises:
            InputError: it has another form; the message gives the valid ones.
        """
        match = _FORM.fullmatch(text) if len(text) <= _LONGEST else None
        if match is None:
            raise InputError(f"requirement '{text}': {_HOW}")
        quantity, reference = match["quantity"], match["times"] or match["reference"] or ""
        check_name("quantity", quantity, QUANTITIES, f"requirement '{text}'")
        if reference and reference not in QUANTITIES[quantity]:
            multiples = f" or a multiple of {' or '.join(QUANTITIES[quantity])}" if QUANTITIES[quantity] else ""
            raise InputError(
                f"requirement '{text}': {quantity} is compared with a number{multiples}, not with '{reference}'"
            )
        factor = float(match["number"] or 1.0)
        return Requirement(text, match["place"] or "", quantity, match["comparison"], factor, reference)

    def checked(self, values: Mapping[str, Values]) -> list[Outcome]:
        """Check the requirement at each place that it applies to.

        Args:
            values: by quantity, the numbers at every place.

        Raises:
            InputError: there is no such place, or nothing at all to compare.
        """
        places = values[self.quantity]
        if self.place and self.place not in places:
            raise InputError(f"requirement '{self.text}': {unknown_name('place', self.place, places)}")
        chosen = [self.place] if self.place else [place for place in places if place != TOTAL]
        outcomes = [self._outcome(place, places[place]) for place in chosen]
        if all(outcome.passed is None for outcome in outcomes):
            hint = f" or the model has no {self.reference}" if self.reference else ""
            raise InputError(f"requirement '{self.text}': nothing to check, no {self.quantity} is measured{hint}")
        return outcomes

    def _outcome(self, place: str, numbers: Mapping[str, float]) -> Outcome:
        """Check one place. Raises InputError if the bound at a place that the user names is not known."""
        value, bound = numbers["value"], self.factor * (numbers[self.reference] if self.reference else 1.0)
        if self.place and math.isnan(bound):
            raise InputError(f"requirement '{self.text}': the model has no {self.reference} for '{place}'")
        comparable = bool(self.place) or not math.isnan(value + bound)
        passed = _COMPARISONS[self.comparison](value, bound) if comparable else None  # no verdict on NaN: not measured
        limit = "not known" if math.isnan(bound) else f"{self.comparison} {bound:.4g}"
        return Outcome(self.text, f"{place}.{self.quantity}", value, limit, passed)


@dataclass(frozen=True)
class Outcome:
    """Result of one ``requirement``: ``what`` was compared, its ``value``, and the ``bound`` with its comparison.
    ``passed`` is None if a requirement for every place cannot be checked here: not measured, or no reference."""

    requirement: str
    what: str
    value: float
    bound: str
    passed: bool | None

    @property
    def result(self) -> str:
        """Result in words."""
        return {True: "passed", False: "FAILED", None: "not checked"}[self.passed]

    @property
    def sentence(self) -> str:
        """Requirement, value, bound and result in words."""
        return f"{self.requirement}: {self.what} is {self.value:.4g}, {self.bound}: {self.result}"
