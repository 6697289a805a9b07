"""The filter: zero phase, its pass and stop band, derivatives, polynomials, and interpolation."""

from __future__ import annotations

import re

import numpy as np
import pytest
from scipy.signal import firwin

from geomid_ros.errors import InputError
from geomid_ros.signals import kernels
from geomid_ros.signals.kernels import cubic_weights, derivative_kernels
from geomid_ros.signals.settings import SignalSettings
from geomid_ros.types import FloatArray, IntArray

from .feeding import feed, jittered, pipeline_of, regular, seconds
from .sent import JointMessage

CUTOFF = 5.0
RATES = pytest.mark.parametrize("rate", [50, 500])


def filtered(stamps: IntArray, values: FloatArray, rate: float) -> dict[str, FloatArray]:
    """Joints with positions ``(N, joints)`` through the pipeline: time [s] ``(M,)``; value, first and second
    derivative ``(M, joints)``. Efforts are the positions' negatives, and come out so."""
    names = tuple(f"joint{place}" for place in range(values.shape[1]))
    pipeline = pipeline_of(names, settings=SignalSettings(cutoff=CUTOFF, period=1.0 / rate))
    messages = [JointMessage(int(t), names, row, [], -row) for t, row in zip(stamps, values, strict=True)]
    samples = feed(pipeline, messages)
    np.testing.assert_allclose(samples.effort, -samples.position, rtol=0, atol=1e-12 * np.max(np.abs(values)))
    return {
        "time": seconds(samples.stamps),
        "value": samples.position,
        "first": samples.velocity,
        "second": samples.acceleration,
        "noise": samples.acceleration_noise,
    }


def responses(rate: float, frequencies: list[float]) -> dict[str, FloatArray]:
    """What becomes of sines of these frequencies [Hz], by their amplitudes, which are those of motions."""
    stamps, amplitude = regular(1.0 / rate, 5.0), 1.0 / max(1.0, *frequencies)
    sines = amplitude * np.sin(2.0 * np.pi * np.outer(seconds(stamps), frequencies))
    found = filtered(stamps, sines, rate)
    return {kind: values / (1.0 if kind == "time" else amplitude) for kind, values in found.items()}


def gain_and_phase(time: FloatArray, values: FloatArray, frequency: float) -> tuple[float, float]:
    """Of a response to ``sin(2 pi f t)``, by least squares."""
    angle = 2.0 * np.pi * frequency * time
    (sine, cosine), *_ = np.linalg.lstsq(np.column_stack([np.sin(angle), np.cos(angle)]), values, rcond=None)
    return float(np.hypot(sine, cosine)), float(np.arctan2(cosine, sine))


@RATES
def test_the_passband_comes_out_unchanged(rate: float) -> None:
    """No phase shift at all, the gain within 1e-3; derivatives carry omega and a quarter turn each."""
    frequencies = [0.2, 0.7, 1.5, 2.4]
    out = responses(rate, frequencies)
    for place, frequency in enumerate(frequencies):
        for order, kind in enumerate(("value", "first", "second")):
            gain, phase = gain_and_phase(out["time"], out[kind][:, place], frequency)
            assert gain / (2.0 * np.pi * frequency) ** order == pytest.approx(1.0, abs=1e-3)
            turned_back = np.exp(1j * (phase - 0.5 * np.pi * order))
            assert abs(np.angle(turned_back)) < 1e-6


@pytest.mark.parametrize("stamps", [regular(0.008, 4.0), jittered(0.008, 4.0)], ids=["regular", "irregular"])
def test_polynomials_are_exact(stamps: IntArray) -> None:
    """A line comes out as it is; of a cubic the second derivative does, and both are the filtered cubic's own."""
    rate = 125.0
    line, cubic = np.array([0.7, -0.4]), np.array([0.3, -0.5, 0.2, 0.8])  # highest power first
    polynomials = np.column_stack([np.polyval(line, seconds(stamps)), np.polyval(cubic, seconds(stamps))])
    both = filtered(stamps, polynomials, rate)
    time = both.pop("time")
    out = {kind: values[:, 0] for kind, values in both.items()}
    np.testing.assert_allclose(out["value"], np.polyval(line, time), rtol=0, atol=1e-10)
    np.testing.assert_allclose(out["first"], line[0], rtol=0, atol=1e-10)
    np.testing.assert_allclose(out["second"], 0.0, rtol=0, atol=1e-8)

    out = {kind: values[:, 1] for kind, values in both.items()}
    smooth = np.polyfit(time, out["value"], 3)
    np.testing.assert_allclose(np.polyval(smooth, time), out["value"], rtol=0, atol=1e-10)
    np.testing.assert_allclose(smooth[:2], cubic[:2], rtol=0, atol=1e-9)
    np.testing.assert_allclose(out["first"], np.polyval(np.polyder(smooth), time), rtol=0, atol=1e-9)
    np.testing.assert_allclose(out["second"], np.polyval(np.polyder(cubic, 2), time), rtol=0, atol=1e-7)


@RATES
def test_the_noise_of_accelerations_is_told_from_motion(rate: float) -> None:
    """What white noise of positions adds to them is known up to its scatter, beside motions of up to 3 Hz."""
    stamps = regular(1.0 / rate, 120.0)
    motion = np.sin(2.0 * np.pi * np.outer(seconds(stamps), [0.3, 1.0, 3.0]))
    noise = np.random.default_rng(1).normal(scale=0.002, size=motion.shape)
    clean, noisy = (filtered(stamps, positions, rate) for positions in (motion, motion + noise))
    added = np.mean((noisy["second"] - clean["second"]) ** 2, axis=0)
    np.testing.assert_allclose(np.mean(noisy["noise"] ** 2, axis=0), added, rtol=0.2)
    assert np.all(np.mean(clean["noise"] ** 2, axis=0) < 0.02 * added)


def test_the_lag_is_half_a_kernel() -> None:
    """Samples end where the later halves of two kernels (of motion, and of effects on it) meet the last data."""
    pipeline = pipeline_of(("joint",), settings=SignalSettings(cutoff=CUTOFF, period=0.01))
    stamps = regular(0.01, 4.0)
    samples = feed(pipeline, [JointMessage(int(t), ("joint",), [0.0], [], [0.0]) for t in stamps])
    trailing = (stamps[-1] - samples.stamps[-1]) * 1e-9
    assert pipeline.lag <= trailing <= pipeline.lag + 0.05
    assert pipeline.lag == pytest.approx((2.0 / CUTOFF + 0.03) + (0.5 / CUTOFF + 0.03), abs=0.011)
    assert pipeline_of(("joint",)).lag == 0.0


def test_too_coarse_a_grid_is_refused() -> None:
    mended = "set the parameter filter.cutoff (--cutoff) to 4 or less"
    with pytest.raises(InputError, match=re.escape(f"a cutoff of 5 Hz is too high for data at 10 Hz: {mended}")):
        derivative_kernels(5.0, 0.1)
    with pytest.raises(InputError, match="or less; or stamps are not in seconds"):
        derivative_kernels(5.0, 1.0)  # 1 kHz in milliseconds
    with pytest.raises(InputError, match=r"or less$"):
        pipeline_of(("joint",), settings=SignalSettings(period=0.1))


@pytest.mark.parametrize(("cutoff", "period"), [(3.0, 1 / 30), (5.0, 0.08)])
def test_the_low_pass_is_that_of_the_textbook(cutoff: float, period: float) -> None:
    """The window method's, here by scipy."""
    low_pass = derivative_kernels(cutoff, period)[0, 3:-3]
    theirs = firwin(len(low_pass), cutoff, window=("kaiser", 6.0), fs=1.0 / period)
    np.testing.assert_allclose(low_pass, theirs, rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("gap", [1e-1, 1e-6])
def test_bursts_do_not_amplify_noise(gap: float) -> None:
    """Two messages stamped at almost the same time: a cubic through both would swing out; exact for lines still."""
    for nodes in ([0.0, gap, 1.0, 2.0], [-1.0, 0.0, 1.0, 1.0 + gap], [0.0, 1.0, 1.0 + gap, 2.0]):
        middle = np.array(nodes)[None]
        for share in (0.0, 0.3, 0.5, 1.0):
            time = middle[:, 1] + share * (middle[:, 2] - middle[:, 1])
            weights = cubic_weights(middle, time)
            assert np.sum(weights**2) <= 4.0
            np.testing.assert_allclose([np.sum(weights), np.sum(weights * middle)], [1.0, time[0]], atol=1e-9)


@pytest.mark.parametrize(
    "wrong",
    [
        {"cutoff": 0.0},
        {"cutoff": -1.0},
        {"cutoff": float("nan")},
        {"max_gap": 0.0},
        {"max_gap": float("inf")},
        {"period": -0.01},
        {"period": 1e-9},
        {"period": float("nan")},
        {"effort_gain": 0.0},
        {"effort_gain": float("inf")},
        {"effort_gain": {"joint": float("nan")}},
        {"effort_delay": 2.0},
        {"effort_delay": -1.5},
        {"effort_delay": float("nan")},
    ],
)
def test_settings_without_a_meaning_are_refused(wrong: dict[str, float]) -> None:
    (name,) = wrong
    with pytest.raises(InputError, match=name.replace("_", ".")):
        SignalSettings(**wrong)


def test_the_first_and_the_last_value_go_on_beyond_the_ends_of_a_recording() -> None:
    values = np.random.default_rng(5).standard_normal((120, 2))
    longer = np.concatenate([np.tile(values[0], (90, 1)), values, np.tile(values[-1], (90, 1))])
    for ours, theirs in zip(kernels.filtered(values, 5.0, 0.01), kernels.filtered(longer, 5.0, 0.01), strict=True):
        np.testing.assert_allclose(ours, theirs[90:-90], rtol=0, atol=1e-9 * np.abs(theirs).max())


def test_a_recording_too_slow_for_the_cutoff_is_filtered_as_far_as_it_can_be() -> None:
    values = np.random.default_rng(4).standard_normal((80, 2))
    for ours, theirs in zip(kernels.filtered(values, 50.0, 0.1), kernels.filtered(values, 4.0, 0.1), strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_rows_that_are_asked_for_are_those_of_the_whole() -> None:
    """At the ends, too, beyond which the outermost values go on."""
    values = np.random.default_rng(0).normal(size=(200, 3))
    at = np.array([0, 1, 50, 51, 199])
    for some, whole in zip(kernels.filtered(values, 8.0, 0.01, at), kernels.filtered(values, 8.0, 0.01), strict=True):
        np.testing.assert_allclose(some, whole[at], rtol=1e-12, atol=1e-12 * np.max(np.abs(whole)))
