"""Every command ends with the documented exit status, whatever ends it."""

from __future__ import annotations

import os
import re
import signal
import stat
import subprocess
import sys
import time
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from sfmkit.cli import main
from sfmkit.cli.signals import Terminated
from sfmkit.errors import InputError

DOCS = Path(__file__).parents[2] / "docs/commands.md"


def commands(group: click.Group = main, words: tuple[str, ...] = ()) -> list[tuple[str, ...]]:
    """The words of every command and subcommand."""
    context = click.Context(group)
    found = []
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        assert command is not None
        path = (*words, name)
        if not isinstance(command, click.Group) or command.invoke_without_command:
            found.append(path)
        if isinstance(command, click.Group):
            found += commands(command, path)
    return found


COMMANDS = commands()


def command_at(words: tuple[str, ...]) -> click.Command:
    command: click.Command = main
    for word in words:
        assert isinstance(command, click.Group)
        found = command.get_command(click.Context(command), word)
        assert found is not None
        command = found
    return command


def run(words: tuple[str, ...], monkeypatch, work) -> tuple[int, str]:
    """Exit status and standard error of a command whose work is replaced."""
    command = command_at(words)
    monkeypatch.setattr(command, "callback", lambda *_args, **_options: work())
    required = []
    for p in command.params:
        if p.required:
            value = __file__ if isinstance(p.type, click.Path) and p.type.exists else "x"
            required += [value] if isinstance(p, click.Argument) else [p.opts[0], value]
    result = CliRunner().invoke(main, [*words, *required])
    return result.exit_code, result.stderr


def fail(error: BaseException):
    def work():
        raise error

    return work


def receive(number: int):
    def work():
        os.kill(os.getpid(), number)
        time.sleep(10)

    return work


@pytest.fixture(autouse=True)
def temporary_folder(monkeypatch, tmp_path):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    return tmp_path


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_every_command_ends_with_the_documented_status(words, monkeypatch, temporary_folder):
    assert run(words, monkeypatch, lambda: None) == (0, "")
    assert run(words, monkeypatch, lambda: sys.exit(1))[0] == 1
    assert run(words, monkeypatch, fail(InputError("no good"))) == (2, "error: no good\n")
    assert run(words, monkeypatch, fail(MemoryError()))[0] == 2
    assert run(words, monkeypatch, fail(KeyboardInterrupt()))[0] == 130
    assert run(words, monkeypatch, receive(signal.SIGTERM))[0] == 143
    assert run(words, monkeypatch, receive(signal.SIGHUP))[0] == 129
    assert CliRunner().invoke(main, [*words, "--no-such-option"]).exit_code == 2
    assert CliRunner().invoke(main, [*words, "--help"]).exit_code == 0
    assert list(temporary_folder.iterdir()) == []
    status, message = run(words, monkeypatch, fail(RuntimeError("a\nb")))
    assert status == 70
    assert message.count("\n") == 1
    assert "RuntimeError: a b" in message
    (log,) = temporary_folder.iterdir()
    assert str(log) in message
    assert "Traceback" not in message
    assert "Traceback" in log.read_text()
    assert stat.S_IMODE(log.stat().st_mode) == 0o600


def test_a_log_that_cannot_be_written_goes_to_standard_error(monkeypatch, temporary_folder):
    monkeypatch.setattr("tempfile.tempdir", str(temporary_folder / "no"))
    status, message = run(("operators",), monkeypatch, fail(RuntimeError("x")))
    assert status == 70
    assert "Traceback" in message


def test_ignored_signals_stay_ignored_and_handlers_are_restored(monkeypatch):
    before = signal.getsignal(signal.SIGHUP), signal.getsignal(signal.SIGTERM)
    try:
        signal.signal(signal.SIGHUP, signal.SIG_IGN)  # as nohup does
        work = lambda: os.kill(os.getpid(), signal.SIGHUP)  # noqa: E731
        assert run(("operators",), monkeypatch, work)[0] == 0
        assert signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
        assert signal.getsignal(signal.SIGTERM) == before[1]
    finally:
        signal.signal(signal.SIGHUP, before[0])


def test_the_statuses_and_the_commands_are_documented():
    text = DOCS.read_text()
    for status in (0, 1, 2, 70, 129, 130, 143):
        assert re.search(rf"^\| {status} \|", text, re.MULTILINE), status
    for words in COMMANDS:
        assert f"`sfmkit {' '.join(words)}" in text, words


BAD_OPTIONS = [
    ("reconstruct a b", "--seed", ["-1", "99999999999999999999", "2147483648", "1.5", "nan"]),
    ("reconstruct a b", "--threshold", ["0", "-1", "nan", "inf", "-inf", "1e999", "one"]),
    ("reconstruct a b", "--budget", ["0", "-1", "nan", "99999999999"]),
    ("reconstruct a b", "--max-size", ["0", "15", "-1", "1000000"]),
    ("density a", "--radius", ["0", "-1", "nan", "inf"]),
    ("compare a b", "--radius", ["0", "-1", "nan", "inf"]),
    ("compare a b", "--seed", ["-1", "99999999999999999999"]),
    ("inspect a", "--point", ["-1", "99999999999999999999", "x"]),
    ("lab", "--port", ["-1", "65536", "x"]),
    ("ablate", "--seeds", ["0", "-1", "1e3"]),
    ("ablate", "--workers", ["0", "-1"]),
    ("ablate", "--cache-size", ["0", "-1GB", "nan", "1e9", "9" * 400, ".", "8PB"]),
    ("ablate report a", "--worst", ["0", "21"]),
    ("bench oxford", "--seeds", ["0"]),
    ("bench oxford", "--workers", ["0"]),
    ("bench fountain", "--max-size", ["0"]),
    ("bench uav", "--step", ["0", "-1"]),
    ("bench pairs --data x", "--seeds", ["0"]),
]


@pytest.mark.parametrize("command, option, values", BAD_OPTIONS, ids=lambda v: str(v)[:20])
def test_values_of_options_are_checked_before_the_work(command, option, values, monkeypatch):
    words = command.split()
    for value in values:
        result = CliRunner().invoke(main, [*words, f"{option}={value}"])
        assert result.exit_code == 2, (value, result.output)
        assert option in result.stderr, (value, result.stderr)


def shell(line: str, **environment: str) -> subprocess.CompletedProcess:
    command = line.replace("sfmkit", f"{sys.executable} -m sfmkit.cli")
    return subprocess.run(
        ["sh", "-c", command],
        env={**os.environ, **environment},
        capture_output=True,
        timeout=300,
        check=False,
    )


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="there is no /dev/full")
@pytest.mark.parametrize("unbuffered", ["", "1"])
def test_standard_output_that_cannot_be_written(unbuffered):
    done = shell("sfmkit data list > /dev/full", PYTHONUNBUFFERED=unbuffered)
    assert done.returncode == 2
    assert done.stderr.startswith(b"error: standard output cannot be written: No space left")
    assert b"Traceback" not in done.stderr


@pytest.mark.skipif(sys.platform == "win32", reason="a shell of POSIX")
def test_closed_streams_and_other_encodings(tmp_path):
    done = shell("sfmkit data list >&-")
    assert done.returncode == 2
    assert b"standard output cannot be written" in done.stderr
    done = shell(f"sfmkit inspect '{tmp_path}/é.rrd' >&- 2>&- <&-")
    assert (done.returncode, done.stdout, done.stderr) == (2, b"", b"")
    done = shell("sfmkit data list", PYTHONIOENCODING="ascii")
    assert done.returncode == 0
    done = shell(f"sfmkit inspect '{tmp_path}/é.rrd' 2>&1", PYTHONIOENCODING="ascii")
    assert done.returncode == 2
    assert b"Traceback" not in done.stdout
    done = shell("sfmkit data list | true; exit ${PIPESTATUS:-0}")
    assert done.stderr == b""


def test_a_signal_while_a_module_is_imported_ends_like_any_other(monkeypatch):
    def fail(*_, **__):
        try:
            raise Terminated(signal.SIGTERM)
        except Terminated as interrupt:
            raise ImportError("initialization failed") from interrupt

    monkeypatch.setattr(click.Command, "invoke", fail)
    result = CliRunner().invoke(main, ["operators"])
    assert result.exit_code == 128 + signal.SIGTERM
    assert "ended by SIGTERM" in result.output
