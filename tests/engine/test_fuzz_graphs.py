"""Damaged graphs: `check` gives a graph or an error that names the file, whatever was done to the text of a shipped one.

KINEGRAPH_FUZZ_GRAPHS says how many are tried; a few hundred without it.
"""

from __future__ import annotations

import os
import random
import re
from pathlib import Path

import pytest

from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.graph.plan import plan
from kinegraph.stream.graph.reading.load import load_text

CONFIGS = sorted((Path(__file__).resolve().parents[2] / "configs").glob("*.yaml"))
TRIED = int(os.environ.get("KINEGRAPH_FUZZ_GRAPHS", "260"))
WORDS = (
    "0", "-1", "1e309", ".nan", ".inf", "null", "true", "[]", "{}", "''", "'\\u202e'", "[[1]]", "!!python/object:os.system",
    "&a [*a]", "1_0", "99999999999999999999", "0x10", "12:30", "2026-01-01", "~", "*x", "node", "from", "nodes", "|", ">", "\\t",
    "- -", "? x", "%TAG", "'", '"',
)  # fmt: skip


def damaged(text: str, dice: random.Random) -> str:
    """One to four changes: a value by a word, a line twice or gone, two lines in the other order, a letter, an indentation."""
    lines = text.splitlines()
    for _ in range(dice.randint(1, 4)):
        i = dice.randrange(len(lines))
        match dice.randrange(7):
            case 0:
                lines[i] = re.sub(r": .*", lambda _: f": {dice.choice(WORDS)}", lines[i])
            case 1:
                lines.insert(i, lines[dice.randrange(len(lines))])
            case 2 if len(lines) > 1:
                del lines[i]
            case 3:
                j = dice.randrange(len(lines))
                lines[i], lines[j] = lines[j], lines[i]
            case 4 if lines[i]:
                at = dice.randrange(len(lines[i]))
                lines[i] = lines[i][:at] + dice.choice("x0-:{}[]#&*!|'\"%@`, \t\x00\u202e") + lines[i][at + 1 :]
            case 5:
                lines[i] = " " * dice.randrange(5) + lines[i]
            case _:
                lines[i] = re.sub(r"\d+(\.\d+)?", lambda _: dice.choice(WORDS[:8]), lines[i], count=1)
    return "\n".join(lines)


@pytest.mark.parametrize("config", CONFIGS, ids=lambda path: path.stem)
def test_a_damaged_graph_is_refused_or_runs(config: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    text, dice = config.read_text(encoding="utf-8"), random.Random(config.stem)
    refused = 0
    for _ in range(max(1, TRIED // len(CONFIGS))):
        given = damaged(text, dice)
        try:
            plan(load_text(given, path="g.yaml"))
        except KinegraphError as error:
            refused += 1
            assert str(error).strip() and "Traceback" not in str(error), given
        except Exception as error:
            raise AssertionError(f"{type(error).__name__}: {error}\n{given}") from error
    assert refused or TRIED < 100
