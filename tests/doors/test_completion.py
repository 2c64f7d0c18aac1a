"""Completion in shells: commands, options and files, from the parsers themselves."""

from __future__ import annotations

import shutil
import subprocess

import pytest

from aridcal import completion
from aridcal.__main__ import COMMANDS

COMPLETE = """
source "$1"
COMP_WORDS=("${@:2}"); COMP_CWORD=$((${#COMP_WORDS[@]} - 1)); COMP_LINE="${COMP_WORDS[*]}"
_shtab_aridcal
printf '%s\\n' "${COMPREPLY[@]}"
"""


@pytest.fixture(scope="module")
def script(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        lines: list[str] = []
        patch.setattr("builtins.print", lines.append)
        assert completion.main(["bash"]) == 0
    path = tmp_path_factory.mktemp("completion") / "aridcal"
    path.write_text("\n".join(lines))
    return path


def completed(script, *typed: str, cwd=None) -> set[str]:
    run = ["bash", "-c", COMPLETE, "bash", str(script), "aridcal", *typed]
    return set(subprocess.run(run, capture_output=True, text=True, check=True, cwd=cwd).stdout.split())


@pytest.mark.skipif(shutil.which("bash") is None, reason="needs bash")
def test_bash_completes_commands_options_and_files(script, tmp_path):
    (tmp_path / "campaign.yaml").touch()
    assert completed(script, "") >= set(COMMANDS)
    assert completed(script, "id") == {"identify"}
    assert completed(script, "identify", "--ver") == {"--verify"}
    assert completed(script, "completion", "ba") == {"bash"}
    assert completed(script, "identify", "camp", cwd=tmp_path) == {"campaign.yaml"}


@pytest.mark.parametrize("shell", ["zsh", "tcsh"])
def test_other_shells_get_every_command(shell, capsys):
    assert completion.main([shell]) == 0
    out = capsys.readouterr().out
    assert all(command in out for command in COMMANDS)
