"""BrainFlow's own boards as one source: the synthetic one, and a playback of a file that BrainFlow wrote, value for value."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from kinegraph.devices.brainflow.source import BrainflowBoard
from kinegraph.stream.errors import ParameterError
from tests.support.device_feed import check, reading, wait_for

shim = pytest.importorskip("brainflow.board_shim")


def test_the_synthetic_board_and_its_markers() -> None:
    source = BrainflowBoard("SYNTHETIC_BOARD")
    specs = source.specs()
    assert (
        specs["out"].rate_hz == 250 and specs["out"].channels[:2] == ("Fz", "C3") and specs["out"].unit_of("Fz") == "uV"
    )
    assert specs["out"].unit_of("accel1") == ""
    with reading(source) as feed:
        wait_for(lambda: feed.error is not None or feed.count("out") > 300)
    assert feed.error is None, feed.error
    check(source, feed)
    assert not feed.lost("out") and np.median(np.diff(feed.time("out"))) == pytest.approx(4e6, rel=1e-3)


@pytest.fixture
def recording(tmp_path: Path) -> tuple[Path, np.ndarray]:
    """A file of BrainFlow's own, and what it holds (rows, n)."""
    from brainflow.data_filter import DataFilter

    rng = np.random.default_rng(3)
    described = shim.BoardShim.get_board_descr(0)
    rows = np.round(rng.normal(size=(described["num_rows"], 500)), 3)
    rows[described["package_num_channel"]] = np.arange(500) % 256
    rows[described["timestamp_channel"]] = 1.7e9 + np.arange(500) / 250
    kept = np.delete(rows, slice(200, 203), axis=1)
    DataFilter.write_file(kept, str(tmp_path / "made.csv"), "w")
    return tmp_path / "made.csv", kept


def test_a_playback_gives_its_file_value_for_value_with_its_gap(recording: tuple[Path, np.ndarray]) -> None:
    path, rows = recording
    source = BrainflowBoard("PLAYBACK_FILE_BOARD", master_board="CYTON_BOARD", file=path, kinds=("emg",))
    with reading(source) as feed:
        wait_for(lambda: feed.error is not None or feed.count("out") >= 480)
    assert feed.error is None, feed.error
    check(source, feed)
    places = shim.BoardShim.get_board_descr(0)["emg_channels"]
    data = feed.data("out")[:480]
    assert np.array_equal(data, rows[places].T[: len(data)])
    assert feed.lost("out").get(200) == 3 and feed.problems["lost row"] == 3


def test_what_a_board_does_not_have_is_told() -> None:
    with pytest.raises(ParameterError, match="SYNTHETIC_BOARD"):
        BrainflowBoard("SYNTETIC_BOARD").specs()
    with pytest.raises(ParameterError, match="kinds that CYTON_BOARD has"):
        BrainflowBoard("CYTON_BOARD", kinds=("ppg",)).specs()
    with pytest.raises(ParameterError, match="one that CYTON_BOARD has"):
        BrainflowBoard("CYTON_BOARD", preset="ancillary").specs()


@pytest.mark.parametrize("board", [b.name for b in shim.BoardIds if b.value >= 0])
def test_every_board_that_brainflow_describes_has_specs(board: str) -> None:
    source = BrainflowBoard(board)
    assert len(set(source.specs()["out"].channels)) == source.specs()["out"].shape[0]


def test_a_board_that_is_not_there_is_told() -> None:
    with reading(BrainflowBoard("CYTON_BOARD", serial_port="/dev/nowhere")) as feed:
        wait_for(lambda: feed.error is not None)
    assert "CYTON_BOARD cannot be opened by BrainFlow" in str(feed.error)
