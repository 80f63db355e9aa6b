"""configs/trigno_emg.yaml: three muscles with a Delsys Trigno, and their envelopes.

Recording: a biceps brachii that was flexed, as Delsys's software exported it (Kinetics Toolkit's sample; Apache-2.0), read here as a
user would import it. It stands in for each of the three sensors: as it is, a tenth as loud, and silent.
Truth: pandas reads the table, scipy makes the envelope.
"""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

import kinegraph as kg
from kinegraph.devices.formats.column_table import ImportOptions
from kinegraph.devices.formats.importer import read_files
from kinegraph.stream.chunk import NS
from tests.replay.replaying import at, emg_envelope, highpassed, signal
from tests.support.real import real_file

EXPORT = real_file("files/delsys/biceps_two_column.csv")
TABLE = pd.read_csv(EXPORT)
SECONDS, MICROVOLT = TABLE["Time"].to_numpy(), 1e6 * TABLE["BicepsBrachiiR"].to_numpy()
SHARES = np.array([1.0, 0.1, 0.0])


@pytest.fixture(scope="module")
def imported() -> kg.Series:
    (series,) = read_files([EXPORT], ImportOptions())
    return series


@pytest.fixture(scope="module")
def envelope(imported: kg.Series) -> kg.Series:
    rate_hz = imported.spec.rate_hz
    emg = signal(1e6 * imported.data * SHARES, rate_hz, ["TA", "SO", "GM"], ["uV"], time_s=imported.time / NS)
    axes = [f"{m}.{kind}{axis}" for m in ("TA", "SO", "GM") for kind in "agm" for axis in "xyz"]
    aux = signal(np.zeros((3, 27)), 148.0, axes, (["g"] * 3 + ["deg/s"] * 3 + [""] * 3) * 3)
    return kg.load("trigno_emg").run({"trigno.emg": emg, "trigno.aux": aux})["leg.chain.envelope"]


def test_the_export_is_read_with_the_rate_that_its_stamps_have(imported: kg.Series) -> None:
    assert imported.spec.rate_hz == pytest.approx((len(TABLE) - 1) / (SECONDS[-1] - SECONDS[0]), rel=1e-4)
    np.testing.assert_allclose(imported.data[:, 0], TABLE["BicepsBrachiiR"])
    np.testing.assert_allclose(
        imported.time / NS, SECONDS, atol=3e-4
    )  # the table's stamps are rounded, and drift from 1/rate


def test_the_envelope_is_scipys(envelope: kg.Series, imported: kg.Series) -> None:
    rate_hz = float(imported.spec.rate_hz or 0)
    offline = emg_envelope(MICROVOLT, rate_hz)
    offline = at(envelope, imported.time / NS, offline) * SHARES
    np.testing.assert_allclose(envelope.data[60:-60], offline[60:-60], atol=0.005 * offline.max())


def test_the_envelope_rises_and_falls_with_the_muscle(envelope: kg.Series, imported: kg.Series) -> None:
    """The mean amplitude of the high-passed samples in windows of a quarter of a second, beside the envelope's."""
    edges = np.arange(SECONDS[0], SECONDS[-1], 0.25)
    raw, live = np.digitize(imported.time / NS, edges), np.digitize(envelope.time / NS, edges)
    clean = highpassed(MICROVOLT, float(imported.spec.rate_hz or 0))
    loud = [np.abs(clean[raw == k]).mean() for k in range(1, len(edges) - 1)]
    mean = [envelope.data[live == k, 0].mean() for k in range(1, len(edges) - 1)]
    assert max(loud) > 5 * min(loud)
    assert np.corrcoef(loud, mean)[0, 1] > 0.98
