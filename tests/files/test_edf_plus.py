"""The night as EDF+: written for every length of night and of annotation, in whole numbers, and read by others as it was meant."""

from __future__ import annotations

import io
from datetime import datetime
from pathlib import Path

import edfio
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinegraph.devices.formats.edf import edf_plus
from kinegraph.devices.formats.edf.edf_plus import EdfSignal, Head, Note
from kinegraph.devices.reports.night import archive
from kinegraph.devices.reports.night.edf import write_edf
from kinegraph.stream.chunk import NS
from kinegraph.stream.errors import DeviceError
from tests.support.tiers import rest_nightly

EVENING = 1_767_218_400 * NS
STEP = 30 * NS


def night(n: int, gaps: tuple[tuple[int, int], ...] = ()) -> archive.LoggedEpochs:
    """`n` epochs, those of the gaps (first, stop) missing: the power was cut."""
    there = np.ones(n, np.bool_)
    for first, stop in gaps:
        there[first:stop] = False
    onset = (EVENING + np.arange(n) * STEP)[there]
    states = np.array(["sleep", "wake", "unknown"])[np.arange(n) % 3][there]
    texts = {"state": states, "bed": np.full(len(onset), "in"), "provisional": states}
    numbers = {
        "activity": np.linspace(0, 1, n)[there],
        "breaths_per_min": np.where(np.arange(n) % 5, 13.0, np.nan)[there],
    }
    return archive.LoggedEpochs(onset, onset + STEP, texts, numbers)


def written(folder: Path, facts: archive.Facts, epochs: archive.LoggedEpochs) -> edfio.Edf:
    write_edf(folder / "n.edf", facts, epochs)
    return edfio.read_edf(folder / "n.edf")


@pytest.mark.parametrize("n", rest_nightly(333, 1, 960, 1117))
def test_an_annotation_of_any_length_can_be_written(tmp_path: Path, n: int) -> None:
    for length in range(8, 201):
        facts = archive.Facts("n", EVENING, 30.0, "UTC", switched=[[EVENING + n // 2 * STEP, "x" * length]])
        edf = written(tmp_path, facts, night(n))
        assert len(edf.signals[0].data) == n and len(edf.annotations) == n + 1, "no epoch is padded or missing"
        assert [len(a.text) for a in edf.annotations if not a.text.startswith("Sleep stage")] == [length]


@given(
    st.integers(1, 1500),
    st.lists(st.tuples(st.integers(0, 1400), st.integers(1, 90)), max_size=4),
    st.lists(st.integers(0, 1500 * 30 * NS), max_size=4),
)
@settings(max_examples=60, deadline=None)
def test_nights_with_power_cuts_and_lights_that_go_off_after_going_to_bed(
    tmp_path_factory: pytest.TempPathFactory, n: int, cuts: list[tuple[int, int]], lights: list[int]
) -> None:
    epochs = night(n + 1, tuple((a + 1, min(a + 1 + k, n)) for a, k in cuts if a + 1 < n))
    breaks = [[EVENING + a * STEP, EVENING + (a + k) * STEP] for a, k in cuts]
    switched = [[EVENING + t, "lights off"] for t in sorted(lights)]
    edf = written(
        tmp_path_factory.mktemp("edf"), archive.Facts("n", EVENING, 30.0, breaks=breaks, switched=switched), epochs
    )
    stages = [(round(a.onset), a.text[-1]) for a in edf.annotations if a.text.startswith("Sleep stage")]
    letters = {"wake": "W", "sleep": "S", "unknown": "?"}
    assert stages == [
        (int(t - EVENING) // NS, letters[str(s)])
        for t, s in zip(epochs.onset, epochs.texts["state"], strict=True)
    ]  # fmt: skip
    off = [a.onset for a in edf.annotations if a.text == "Lights off"]
    np.testing.assert_allclose(off, sorted(t / NS for t in lights), atol=1e-9)
    assert sum(a.text == "Not running" for a in edf.annotations) == len(cuts)
    place = (epochs.onset - EVENING) // STEP
    assert len(edf.signals[0].data) == n + 1
    np.testing.assert_allclose(edf.signals[0].data[place], epochs.numbers["activity"], atol=1e-4)


@pytest.mark.parametrize("n", [1, 2, 16, 64, 100])
def test_it_is_byte_for_byte_what_edfio_writes_where_edfio_can(n: int) -> None:
    """Records of 32 s: edfio's floating-point lengths are exact there."""
    values = np.linspace(-1, 4, n)
    begun = datetime(2025, 12, 31, 23, 20)
    notes = [Note(k * 32 * NS, 32 * NS, "Sleep stage S") for k in range(n)] + [Note(5 * NS // 2, None, "Lights off")]
    notes.append(Note((n + 2) * 32 * NS, None, "after the end"))
    ours = edf_plus.encode(
        Head("me", "kinegraph", begun), 32 * NS, [EdfSignal("Activity", "", -1.0, 4.0, values)], notes
    )  # fmt: skip
    file = io.BytesIO()
    edfio.Edf(
        [edfio.EdfSignal(values, 1 / 32, label="Activity", physical_range=(-1.0, 4.0))],
        patient=edfio.Patient(code="me"),
        recording=edfio.Recording(startdate=begun.date(), equipment_code="kinegraph"),
        starttime=begun.time(),
        data_record_duration=32,
        annotations=[edfio.EdfAnnotation(a.onset / NS, a.length / NS if a.length else None, a.text) for a in notes],
    ).write(file)
    assert ours == file.getvalue()


def test_a_night_of_which_nothing_is_known_has_an_edf_too(tmp_path: Path) -> None:
    epochs = night(40)
    for column in epochs.numbers.values():
        column[:] = np.nan
    edf = written(tmp_path, archive.Facts("n", EVENING, 30.0), epochs)
    assert (edf.signals[0].data == -1).all() and len(edf.annotations) == 40


@pytest.mark.parametrize(("epoch_s", "text"), [(30.0, "30"), (12.5, "12.5"), (0.001, "0.001")])
def test_the_length_of_a_record_is_exact(epoch_s: float, text: str) -> None:
    made = edf_plus.encode(
        Head("me", "kinegraph", datetime(2026, 1, 1)), round(epoch_s * NS), [EdfSignal("a", "", 0, 1, np.zeros(3))], []
    )
    assert made[244:252].decode().rstrip() == text and int(made[236:244]) == 3


def test_a_length_that_edf_cannot_write_is_named() -> None:
    with pytest.raises(DeviceError, match=r"epochs of 4\.285714286 s"):
        edf_plus.encode(
            Head("me", "kinegraph", datetime(2026, 1, 1)), 4_285_714_286, [EdfSignal("a", "", 0, 1, np.zeros(3))], []
        )
