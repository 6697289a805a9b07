"""An identification problem at the level of rows, the same for every method."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from geomid_ros.geometry.manifold import ParameterManifold, Point
from geomid_ros.types import AnyArray, FloatArray, IntArray

_PIECE = 4096  # rows

DATA = Path(__file__).parents[2] / "shared" / "data"


class DataAbsentError(Exception):
    """The measured data that an experiment reads are not on this machine."""


def measured(folder: str) -> Path:
    """A folder of the measured data. Raises DataAbsentError where there is none."""
    path = DATA / folder
    if not path.is_dir():
        raise DataAbsentError(f"needs the measured data in {path}, which are not part of this repository")
    return path


@dataclass(frozen=True, eq=False)
class Rows:
    """``coefficients (N, D)``, ``targets (N,)``, standard deviations ``sigmas (N,)``, and of each row the index of its
    ``channel (N,)`` and the place in time ``instant (N,)``."""

    coefficients: FloatArray
    targets: FloatArray
    sigmas: FloatArray
    channel: IntArray
    instant: IntArray

    def __len__(self) -> int:
        return len(self.targets)

    def select(self, chosen: AnyArray | slice) -> Rows:
        """The rows chosen by a mask, indices or a slice."""
        return Rows(*(getattr(self, name)[chosen] for name in self.__dataclass_fields__))

    def until(self, share: float) -> tuple[Rows, Rows]:
        """The rows of the first ``share`` of the instants, and the others."""
        instants = np.unique(self.instant)
        early = self.instant < instants[round(share * len(instants))]
        return self.select(early), self.select(~early)

    def rms(self, parameters: FloatArray) -> FloatArray:
        """Root mean square residual of each channel, ``(channels,)``."""
        squares = (self.coefficients @ parameters - self.targets) ** 2
        return np.array([np.sqrt(np.mean(squares[self.channel == k])) for k in range(int(self.channel.max()) + 1)])

    @property
    def whitened(self) -> tuple[FloatArray, FloatArray]:
        """Rows and targets divided by their standard deviations."""
        return self.coefficients / self.sigmas[:, None], self.targets / self.sigmas

    def compressed(self) -> Rows:
        """At most D rows with standard deviation 1 and the same least-squares content, by QR."""
        unknowns = self.coefficients.shape[1]
        factor = np.zeros((0, unknowns + 1))
        for begin in range(0, len(self), _PIECE):
            piece = self.select(slice(begin, begin + _PIECE))
            factor = np.linalg.qr(np.concatenate([factor, np.column_stack(piece.whitened)]), mode="r")
        factor = factor[:unknowns]
        count = len(factor)
        zeros = np.zeros(count, dtype=np.int64)
        return Rows(factor[:, :-1].copy(), factor[:, -1].copy(), np.ones(count), zeros, zeros)


@dataclass(frozen=True, eq=False)
class Problem:
    """Rows to train on and to judge by, the prior's parameters ``(D,)``, and the true ones where they are known."""

    name: str
    channels: tuple[str, ...]
    manifold: ParameterManifold
    prior: FloatArray
    train: Rows
    validation: Rows
    truth: FloatArray | None = None

    @property
    def prior_point(self) -> Point:
        """The prior as a point."""
        return self.manifold.point(self.prior)

    def with_train(self, train: Rows) -> Problem:
        """The same problem with other rows to train on."""
        return replace(self, train=train)
