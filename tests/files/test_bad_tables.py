"""Files that cannot be imported and exports that would replace something: reported, and no half file remains."""

from __future__ import annotations

import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from tests.support.command_line import BOARD, Command, refused, wait_for
from tests.support.tiers import rest_nightly

TABLES: list[tuple[str | bytes, str]] = [
    ("", "the file is empty"),
    ("time,a\n", "there are no samples"),
    ("1,2\n3,4\n", "line 1: the first line must name the columns"),
    ("time,a\n0,1\n1,2,3\n", "line 3: 3 cells, but the header names 2 columns"),
    ("time,a\n0,1\n1\n", "line 3: 1 cells"),
    ("time,a\n0,1\n\n1,2\n", "line 3: 0 cells"),
    ("time,a\n0,1\n1,2\n1,3\n", "line 4: the time 1 s is repeated"),
    ("time,a\n0,1\n2,2\n1,3\n", "line 4: time runs backwards, from 2 s to 1 s"),
    ("time,a\n0,1\n,2\n", "line 3: 't:time' holds no time"),
    ("time,a\n0,1\n1e300,2\n", "line 3: 't:time' holds no time"),
    ("time,a\n0,x\n", "line 2: 'x' in column 'a' is not a number"),
    ("time,a,\n0,1,2\n", "every column needs a name of its own"),
    ("time\n0\n1\n", "no column for it beside the time"),
    ("a,b\n1,2\n", "when its samples were taken is not known"),
    (bytes(2000), "zero bytes"),
    (bytes(range(128, 256)), "not a text file in UTF-8"),
    ("time,a [µV]\n0,1\n1,2\n".encode("latin-1"), "save it again as UTF-8"),
]


@pytest.mark.parametrize(("text", "words"), TABLES, ids=[words for _, words in TABLES])
def test_a_table_that_cannot_be(text: str | bytes, words: str, kinegraph: Command, tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_bytes(text if isinstance(text, bytes) else text.encode())
    output = kinegraph("files", "import", "t.csv", "-o", "t.mcap")
    refused(output, words)
    assert not output[2].startswith("\n"), "no trace of an invisible progress bar"
    assert [p.name for p in tmp_path.iterdir()] == ["t.csv"]


WISHES = [
    (["--stream", "x=a"], "give --rate x=HZ or --time x=COLUMN"),
    (["--stream", "x=a", "--rate", "nan"], "must be a finite number"),
    (["--stream", "x=a", "--rate", "1e30"], "must be a positive number of Hz"),
    (["--stream", "x=,", "--rate", "1"], "there is no column"),
    (["--stream", "x=none", "--rate", "1"], "there is no column or array 'none'"),
    (["--stream", "x=hollow", "--rate", "1"], "has no channels"),
    (["--stream", "x=texts", "--rate", "1"], "holds no numbers"),
    (["--stream", "x=a", "--time", "texts"], "holds no time"),
    (["--stream", "x=a", "--rate", "1", "--counter", "texts"], "the counter holds something else than whole numbers"),
    (["--events", "e=texts"], "holds no time"),
    (["--stream", "x=a", "--rate", "1", "--scale", "inf"], "--scale x: inf must be a finite number"),
    (["--stream", "x=a", "--rate", "1", "--start", "9999-12-31"], "must lie between 1900 and 2100"),
    (["--stream", "x=a", "--rate", "1", "--chunk-ms", "nan"], "--chunk-ms"),
]


@pytest.mark.parametrize(("options", "words"), WISHES, ids=[words for _, words in WISHES])
def test_streams_that_cannot_be_made(options: list[str], words: str, kinegraph: Command, tmp_path: Path) -> None:
    np.savez(tmp_path / "t.npz", a=np.arange(50.0), texts=np.array(["x"] * 50), hollow=np.zeros((50, 0)))
    refused(kinegraph("files", "import", "t.npz", "-o", "t.mcap", *options), words)
    assert [p.name for p in tmp_path.iterdir()] == ["t.npz"]


def test_files_that_are_not_what_their_names_say(kinegraph: Command, tmp_path: Path) -> None:
    junk = random.Random(1).randbytes(3000)
    for name, data in (("e.npz", b""), ("g.npz", junk), ("e.xdf", b""), ("g.xdf", junk), ("h.xdf", b"XDF:" + junk)):
        (tmp_path / name).write_bytes(data)
        refused(kinegraph("files", "import", name, "-o", "t.mcap", "--stream", "x=a", "--rate", "1"), name)
    np.savez(tmp_path / "o.npz", a=np.array([{"a": 1}], object))
    refused(kinegraph("files", "import", "o.npz", "-o", "t.mcap", "--stream", "x=a"), "array 'a'", "Object arrays")
    (tmp_path / "d.csv").mkdir()
    refused(kinegraph("files", "import", "d.csv", "-o", "t.mcap"), "Is a directory")
    (tmp_path / "a").mkdir()
    for place in (tmp_path, tmp_path / "a"):
        (place / "t.csv").write_text("time,a\n0,1\n1,2\n2,3\n")
    refused(kinegraph("files", "import", "t.csv", "a/t.csv", "-o", "t.mcap"), "has the same name; rename one")
    (tmp_path / "f.mcap").mkdir()
    refused(kinegraph("files", "import", "t.csv", "-o", "f.mcap"), "f.mcap: is a folder")
    refused(kinegraph("files", "import", "t.csv", "-o", "t.csv/t.mcap"), "t.csv: is a file")
    refused(kinegraph("files", "import", "t.csv", "-o", "t"), "must end in .mcap")
    assert not (tmp_path / "t.mcap").exists()


def test_what_is_there_is_not_replaced(kinegraph: Command, made: Path, tmp_path: Path) -> None:
    whole = made / "s"
    assert kinegraph("files", "export", whole, "-o", "tables", "--stream", "rect")[0] == 0
    table = tmp_path / "tables" / "rect.csv"
    table.write_text("mine")
    refused(
        kinegraph("files", "export", whole, "-o", "tables", "--stream", "rect"),
        "rect.csv: already exists",
        "--overwrite",
    )
    assert table.read_text() == "mine"
    assert kinegraph("files", "export", whole, "-o", "tables", "--stream", "rect", "--overwrite")[0] == 0
    assert len(table.read_text()) > 1000
    (tmp_path / "x.xdf").write_text("mine")
    refused(kinegraph("files", "export", whole, "-o", "x.xdf", "--format", "xdf"), "x.xdf: already exists")
    refused(kinegraph("files", "export", whole, "-o", "x.xdf"), "x.xdf: already exists")
    (tmp_path / "rows").write_text("mine")
    refused(kinegraph("files", "export", whole, "-o", "rows"), "rows: is a file; name a folder")
    assert kinegraph("files", "import", table, "-o", "t.mcap")[0] == 0
    before = (tmp_path / "t.mcap").read_bytes()
    refused(kinegraph("files", "import", table, "-o", "t.mcap"), "t.mcap: already holds a recording", "--overwrite")
    assert (tmp_path / "t.mcap").read_bytes() == before
    assert kinegraph("files", "import", table, "-o", "t.mcap", "--unit", "mV", "--overwrite")[0] == 0
    assert "mV" in kinegraph("info", "t.mcap")[1]
    refused(kinegraph("recover", whole, "-o", "t.mcap"), "already holds a recording")
    refused(kinegraph("replay", made / "graph.yaml", whole, "-o", "t.mcap"), "already holds a recording")


def test_nothing_is_verified_where_there_is_nothing_to_compare(kinegraph: Command, made: Path, tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text("time,a [uV],b\n0,1,1\n1,2,1\n2,3,1\n")
    code, output, _ = kinegraph(
        "files", "import", "t.csv", "-o", "t.mcap", "--stream", "board.emg=a,b", "--time", "time"
    )
    assert code == 0 and "in µV, no unit" in output
    refused(kinegraph("replay", made / "graph.yaml", "t.mcap", "--verify"), "t.mcap holds no output", "`record`")
    (tmp_path / "less.yaml").write_text(BOARD % 2)
    code, output, _ = kinegraph("replay", "less.yaml", made / "s", "--verify")
    assert code == 1 and "rect: NOT COMPARED" in output


def test_streams_that_would_become_one_table_are_kept_apart(kinegraph: Command, tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text("time,a\n0,1\n1,2\n2,3\n")
    both = ("--stream", "x/y=a", "--stream", "x_y=a", "--time", "time")
    assert kinegraph("files", "import", "t.csv", "-o", "t.mcap", *both)[0] == 0
    assert (
        kinegraph("files", "export", "t.mcap", "-o", "out")[1]
        == "x/y: 3 samples to out/x_y.csv\nx_y: 3 samples to out/x_y_2.csv\n"
    )


SLOW = """
import sys, time
from kinegraph.devices.formats.table import csv_writer
from kinegraph.stream.cli import main
from kinegraph.stream.recording.write import recorder

def slowly(function):
    def call(*arguments, **options):
        time.sleep(0.005)
        return function(*arguments, **options)
    return call

csv_writer._stamps = slowly(csv_writer._stamps)
recorder.Recorder.write = slowly(recorder.Recorder.write)
sys.argv = ["kinegraph", *sys.argv[1:]]
main.main()
"""


@pytest.mark.parametrize("ending", rest_nightly(signal.SIGKILL, signal.SIGTERM, signal.SIGINT))
@pytest.mark.parametrize("command", ["import", "export"])
def test_killed_in_the_middle_no_half_file_bears_the_name(
    command: str, ending: signal.Signals, kinegraph: Command, made: Path, tmp_path: Path
) -> None:
    (tmp_path / "t.csv").write_text("time,a\n" + "".join(f"{k / 10},{k}\n" for k in range(20_000)))
    arguments, final = {
        "import": (["files", "import", "t.csv", "-o", "t.mcap"], tmp_path / "t.mcap"),
        "export": (
            ["files", "export", str(made / "s"), "--stream", "rect", "-o", "out"],
            tmp_path / "out" / "rect.csv",
        ),
    }[command]
    process = subprocess.Popen([sys.executable, "-c", SLOW, *arguments], stderr=subprocess.DEVNULL)
    wait_for(lambda: any(final.parent.glob(".*.draft*")) or process.poll() is not None)
    time.sleep(0.1)
    process.send_signal(ending)
    assert process.wait(60) == {signal.SIGKILL: -9, signal.SIGTERM: 143, signal.SIGINT: 130}[ending]
    assert not final.exists()
    if ending != signal.SIGKILL:
        assert not any(final.parent.glob(".*draft*")), "what was begun is cleared away"
    assert kinegraph(*arguments)[0] == 0 and final.exists()
    assert not any(p for p in final.parent.glob(".*draft*")), "and what a kill left, by the next try"
