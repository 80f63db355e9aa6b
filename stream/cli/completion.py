"""`kinegraph dev completion`: what makes a shell complete commands, options, shipped graphs and demos."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

import typer

from kinegraph.stream.errors import KinegraphError, nearest

SCRIPTS = {
    "bash": """_kinegraph() {
  local IFS=$'\\n'
  COMPREPLY=($(kinegraph dev completion bash -- "${COMP_WORDS[@]:1:COMP_CWORD}" 2>/dev/null))
}
complete -o bashdefault -o default -F _kinegraph kinegraph""",
    "zsh": """#compdef kinegraph
_kinegraph() {
  local -a found=("${(@f)$(kinegraph dev completion zsh -- "${words[@]:1:$((CURRENT-1))}" 2>/dev/null)}")
  if [[ -n "$found[1]" ]]; then compadd -- $found; else _files; fi
}
compdef _kinegraph kinegraph""",
    "fish": "complete -c kinegraph -a '(kinegraph dev completion fish -- (commandline -opc)[2..] (commandline -ct) 2>/dev/null)'",
}
"""By shell. Where nothing is found, the shell completes files."""
TAKES_GRAPH = ("run", "replay", "batch", "check", "draw", "configs")


def completion(
    shell: Annotated[str, typer.Argument(help="bash, zsh or fish")],
    words: Annotated[
        list[str] | None, typer.Argument(metavar="[WORD]", help="what has been typed so far, for the shell")
    ] = None,
) -> None:
    """Print what makes bash, zsh or fish complete commands.

    bash: put `source <(kinegraph dev completion bash)` into ~/.bashrc; zsh: the same with zsh into ~/.zshrc, after compinit; fish:
    `kinegraph dev completion fish > ~/.config/fish/completions/kinegraph.fish`.
    """
    if shell not in SCRIPTS:
        raise KinegraphError(f"there is no completion for {shell!r}; {nearest(shell, SCRIPTS)}")
    if words is None:
        print(SCRIPTS[shell])
    else:
        print("\n".join(candidates(words)))


def candidates(words: Sequence[str]) -> list[str]:
    """What the last of these words may become."""
    from kinegraph.stream.cli.registry import command_in, names

    *before, begun = words or [""]
    name = command_in(before)
    if name:
        found = _within(name, before[len(name.split()) :], begun)
    else:
        groups = [known.split()[len(before) :] for known in names() if known.split()[: len(before)] == before]
        found = [rest[0] for rest in groups if rest]
    return sorted({word for word in found if word.startswith(begun)})


def _within(name: str, before: Sequence[str], begun: str) -> list[str]:
    """Behind a command: its options where one has begun, else what its first argument may be."""
    from kinegraph.stream.cli.commands.demo import DEMOS
    from kinegraph.stream.graph.shipped import shipped

    if begun.startswith("-"):
        return _options(name)
    if before:
        return []
    return [*DEMOS] if name == "demo" else [*shipped()] if name in TAKES_GRAPH else []


def _options(name: str) -> list[str]:
    from kinegraph.stream.cli.main import app_of

    command: Any = typer.main.get_command(app_of(name))
    params = [param for inner in (command, *getattr(command, "commands", {}).values()) for param in inner.params]
    return [
        "--help",
        *(option for param in params for option in (*param.opts, *param.secondary_opts) if option.startswith("--")),
    ]
