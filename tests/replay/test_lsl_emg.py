"""configs/lsl_emg.yaml: EMG and a footswitch from the Lab Streaming Layer: muscles' cycles, and the envelope back onto LSL.

Recordings: six muscles of a treadmill walk (Santuz; MIT) in the amplifier's place, with a marker at every touch-down; and two files of
LabRecorder's kind with clock offsets (xdf-modules' examples; MIT), for how such a recording is read.
Truth: scipy makes the envelope; pyxdf reads the files and aligns their clocks.
"""

from __future__ import annotations

import numpy as np
import pytest
import pyxdf

import kinegraph as kg
from kinegraph.devices.formats.column_table import ImportOptions
from kinegraph.devices.formats.importer import read_files
from kinegraph.stream.chunk import NS
from tests.replay.replaying import at, cycles_last_as_long_as_the_files, emg_envelope, footswitch, signal
from tests.support.real import real_arrays, real_file

WALK = real_arrays("emg/emg_santuz_tw12.npz")
CHANNELS = ("TA", "GM", "SO", "RF", "BF", "VM")
EMG = WALK["emg_uV"][:, [WALK["names"].tolist().index(name) for name in CHANNELS]].astype(float)


def test_envelopes_are_scipys_and_cycles_the_files_whatever_the_markers_say() -> None:
    graph = kg.load("lsl_emg")
    stamps = np.round(WALK["touchdown_s"] * NS).astype(np.int64)
    spec = graph.specs["markers"]
    reported = np.array([(stamp, "touch-down") for stamp in stamps], spec.dtype)
    emg = signal(EMG, 1000.0, CHANNELS, ["uV"], time_s=WALK["t_s"])
    pressed = footswitch(WALK["touchdown_s"], WALK["liftoff_s"], 100.0, WALK["t_s"][-1])
    foot = signal(pressed, 100.0, ["right"])
    replayed = graph.run({"emg": emg, "foot": foot, "markers": kg.Series("", spec, stamps, reported)})
    cycles_last_as_long_as_the_files(replayed["leg.cycles.closed"], WALK["touchdown_s"], 0.011)
    live = replayed["leg.chain.envelope"]
    offline = at(live, WALK["t_s"], emg_envelope(EMG, 1000.0))
    assert live.spec.channels == CHANNELS
    np.testing.assert_allclose(live.data[24:-24], offline[24:-24], atol=0.003 * offline.max())


@pytest.mark.parametrize("name", ["minimal", "empty_streams"])
def test_a_recording_of_lsl_has_pyxdfs_samples_and_its_clocks(name: str) -> None:
    file = real_file(f"files/xdf/{name}.xdf")
    ours = {one.name.removeprefix(f"{name}."): one for one in read_files([file], ImportOptions())}
    theirs, _ = pyxdf.load_xdf(file)
    begin = min(stream["time_stamps"][0] for stream in theirs if len(stream["time_stamps"]))
    first = min(one.time[0] for one in ours.values() if len(one))
    for stream in theirs:
        one = ours[stream["info"]["name"][0]]
        assert len(one) == len(stream["time_stamps"])
        np.testing.assert_allclose((one.time - first) / NS, stream["time_stamps"] - begin, atol=1e-6)
        if one.spec.is_event:
            assert [str(text) for text in one.data["text"]] == [row[0] for row in stream["time_series"]]
        else:
            np.testing.assert_array_equal(one.data, np.reshape(stream["time_series"], one.data.shape))
