"""Completion in a shell: the script is asked as bash asks it."""

from __future__ import annotations

import shutil
import subprocess
import sys

import pytest

pytest.importorskip("shtab")
BASH = shutil.which("bash")


@pytest.mark.parametrize("shell", ["bash", "zsh", "tcsh"])
def test_a_script_names_commands_flags_and_values(spawn, shell):
    done = spawn("--print-completion", shell)
    assert (done.code, done.err) == (0, "")
    assert all(word in done.out for word in ("refine", "max-iterations", "huber"))


@pytest.mark.skipif(BASH is None, reason="no bash")
@pytest.mark.parametrize(
    ("words", "completions"),
    [
        (["ref"], {"refine"}),
        (["refine", "--max-e"], {"--max-error"}),
        (["refine", "--loss", "hu"], {"huber"}),
        (["refine", "--loss", "dc"], {"dcs"}),  # of pose graphs
        (["covariance", "--gauge", "in"], {"inner"}),
        (["synth", "--scene", "fl"], {"flight"}),
        (["refine", "--gps", "geo"], {"geo.txt"}),
    ],
)
def test_bash_completes(spawn, tmp_path, words, completions):
    script = spawn("--print-completion", "bash")
    assert (script.code, script.err) == (0, "")
    (tmp_path / "script").write_text(script.out)
    (tmp_path / "geo.txt").touch()
    typed = " ".join(f"'{word}'" for word in ["bundle", *words])
    before = words[-2] if len(words) > 1 else "bundle"
    ask = (
        "source ./script; "
        "f=$(complete -p bundle | sed 's/.*-F \\([^ ]*\\).*/\\1/'); "
        f"COMP_WORDS=({typed}); COMP_CWORD={len(words)}; "
        f"$f bundle '{words[-1]}' '{before}'; printf '%s\\n' \"${{COMPREPLY[@]}}\""
    )
    done = subprocess.run(
        [BASH, "-c", ask], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert set(done.stdout.split()) == completions, done.stderr


def test_without_shtab_the_command_says_so(run, monkeypatch):
    monkeypatch.setitem(sys.modules, "shtab", None)
    code, out, err = run("--print-completion", "bash")
    assert (code, out) == (2, "")
    assert err.startswith("error: --print-completion: expected the package shtab, which is not ")
